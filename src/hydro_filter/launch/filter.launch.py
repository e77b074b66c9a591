# SPDX-License-Identifier: Apache-2.0
"""The filter: `ros2 launch hydro_filter filter.launch.py [metric:=learned|FILE]`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments


def generate_launch_description() -> LaunchDescription:
    refuse_unknown_arguments(__file__, ("metric",))
    words = ["--realtime", "--metric", LaunchConfiguration("metric")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("metric", default_value="learned", description="learned or a weights file"),
            Node(package="hydro_filter", executable="filter", arguments=words, output="screen"),
        ]
    )
