# SPDX-License-Identifier: Apache-2.0
"""The bench over its serial port: `ros2 launch hydro_bridge bridge.launch.py port:=/dev/ttyUSB0`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from hydro_bridge.ros.companion import dashboard_enabled
from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments


def generate_launch_description() -> LaunchDescription:
    refuse_unknown_arguments(__file__, ("port", "dashboard"))
    port = LaunchConfiguration("port")
    return LaunchDescription(
        [
            DeclareLaunchArgument("port", description="serial device of the box"),
            DeclareLaunchArgument(
                "dashboard",
                default_value=str(dashboard_enabled()).lower(),
                description="whether to serve the live page",
            ),
            Node(
                package="hydro_bridge",
                executable="dashboard",
                output="screen",
                condition=IfCondition(LaunchConfiguration("dashboard")),
            ),
            Node(
                package="hydro_bridge", executable="bridge", arguments=["--realtime", "--port", port], output="screen"
            ),
        ]
    )
