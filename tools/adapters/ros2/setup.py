"""The package `edge_vpr_ros`, which colcon builds."""

from setuptools import setup

setup(
    name="edge_vpr_ros",
    version="0.1.0",
    packages=["edge_vpr_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/edge_vpr_ros"]),
        ("share/edge_vpr_ros", ["package.xml"]),
        ("share/edge_vpr_ros/launch", ["launch/edge_vpr.launch.py"]),
        ("share/edge_vpr_ros/config", ["config/edge_vpr.yaml", "config/ekf.yaml"]),
    ],
    entry_points={"console_scripts": ["edge_vpr_node = edge_vpr_ros.node:main"]},
)
