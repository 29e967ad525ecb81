"""Start the node with its parameters: ros2 launch edge_vpr_ros edge_vpr.launch.py."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the node; `connect` and `use_sim_time` may be given on the command line."""
    parameters = Path(get_package_share_directory("edge_vpr_ros"), "config", "edge_vpr.yaml")
    given = {name: LaunchConfiguration(name) for name in ("connect", "use_sim_time")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("connect", default_value="127.0.0.1:7000"),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            Node(
                package="edge_vpr_ros",
                executable="edge_vpr_node",
                name="edge_vpr",
                parameters=[str(parameters), given],
            ),
        ]
    )
