# SPDX-License-Identifier: Apache-2.0
"""The bench over its serial port: `ros2 launch hydro_bridge bridge.launch.py port:=/dev/ttyUSB0`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    port = LaunchConfiguration("port")
    return LaunchDescription(
        [
            DeclareLaunchArgument("port", description="serial device of the box"),
            Node(
                package="hydro_bridge", executable="bridge", arguments=["--realtime", "--port", port], output="screen"
            ),
        ]
    )
