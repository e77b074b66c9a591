# SPDX-License-Identifier: Apache-2.0
"""The filter: `ros2 launch hydro_filter filter.launch.py every:=1`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    every = LaunchConfiguration("every")
    return LaunchDescription(
        [
            DeclareLaunchArgument("every", default_value="1", description="answer every Nth sample: 1 kHz / N"),
            Node(package="hydro_filter", executable="filter", arguments=["--every", every], output="screen"),
        ]
    )
