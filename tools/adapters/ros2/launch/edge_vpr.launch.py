"""Start the node, and as asked for edge-vpr stream and robot_localization's filter."""

import shlex
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

#: Default and meaning of each argument.
ARGUMENTS = {
    "stream": ("", "arguments of edge-vpr stream, to start it here; else it runs already"),
    "connect": ("127.0.0.1:7000", "HOST:PORT of stream --http"),
    "odometry_to": ("", "HOST:PORT of stream --odometry udp://, to send odom there"),
    "odom": ("/odom", "topic of the robot's odometry"),
    "ekf": ("true", "fuse matches and odometry by robot_localization"),
    "use_sim_time": ("false", "stamp by the simulated clock"),
}


def actions(context: LaunchContext) -> list[Action]:
    """Return what is started with these arguments."""
    words = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    config = Path(get_package_share_directory("edge_vpr_ros"), "config")
    simulated = {"use_sim_time": words["use_sim_time"] == "true"}
    started: list[Action] = []
    if words["stream"]:
        command = ["edge-vpr", "stream", "--http", words["connect"], *shlex.split(words["stream"])]
        if words["odometry_to"]:
            command += ["--odometry", f"udp://{words['odometry_to']}"]
        # its own lines are those of the topics
        started.append(ExecuteProcess(cmd=command, output="log", respawn=True, respawn_delay=2.0))
    addresses = {  # text without a type is read as YAML, and empty text is refused
        name: ParameterValue(words[name], value_type=str)
        for name in ("connect", "odometry_to")
        if words[name]
    }
    started.append(
        Node(
            package="edge_vpr_ros",
            executable="edge_vpr_node",
            name="edge_vpr",
            parameters=[str(config / "edge_vpr.yaml"), addresses, simulated],
            remappings=[("/odom", words["odom"])],
        )
    )
    if words["ekf"] == "true":
        started.append(
            Node(
                package="robot_localization",
                executable="ekf_node",
                name="ekf_filter_node",
                parameters=[str(config / "ekf.yaml"), {"odom0": words["odom"]}, simulated],
                # a jump of the node's, or a pose set by hand in RViz, sets the filter's
                remappings=[("set_pose", "/initialpose")],
            )
        )
    return started


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and what is started."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=actions)])
