# SPDX-License-Identifier: Apache-2.0
"""The simulation in the bench's place: `ros2 launch hydro_sim sim.launch.py pace:=real`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from hydro_bridge.ros.companion import dashboard_enabled
from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments


def generate_launch_description() -> LaunchDescription:
    refuse_unknown_arguments(__file__, ("pace", "dashboard"))
    pace, dashboard = LaunchConfiguration("pace"), LaunchConfiguration("dashboard")
    served = str(dashboard_enabled()).lower()
    return LaunchDescription(
        [
            DeclareLaunchArgument("pace", default_value="plant", description="plant, real, or times real time"),
            DeclareLaunchArgument("dashboard", default_value=served, description="whether to serve the live page"),
            Node(package="hydro_bridge", executable="dashboard", output="screen", condition=IfCondition(dashboard)),
            Node(package="hydro_sim", executable="sim", arguments=["--pace", pace], output="screen"),
        ]
    )
