# SPDX-License-Identifier: Apache-2.0
"""The filter: `ros2 launch hydro_filter filter.launch.py [metric:=learned|constant|FILE] [every:=1]`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    words = ["--realtime", "--every", LaunchConfiguration("every"), "--metric", LaunchConfiguration("metric")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("every", default_value="1", description="answer every Nth sample: 1 kHz / N"),
            DeclareLaunchArgument("metric", default_value="learned", description="learned, constant or a weights file"),
            Node(package="hydro_filter", executable="filter", arguments=words, output="screen"),
        ]
    )
