# SPDX-License-Identifier: Apache-2.0
"""An emulated bench behind a serial port: `ros2 launch hydro_sim emulator.launch.py port:=/tmp/hydro-bench`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments
from hydro_sim.emulator.line.terminal import default_link


def generate_launch_description() -> LaunchDescription:
    refuse_unknown_arguments(__file__, ("port", "faults", "pace"))
    # A process and not a Node: like the box itself, the emulator knows no ROS.
    emulator = ExecutableInPackage(package="hydro_sim", executable="emulator")
    port, faults, pace = (LaunchConfiguration(name) for name in ("port", "faults", "pace"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("port", default_value=str(default_link()), description="where its port appears"),
            DeclareLaunchArgument("faults", default_value="clean", description="what goes wrong on the line"),
            DeclareLaunchArgument("pace", default_value="plant", description="plant, real, or times real time"),
            ExecuteProcess(cmd=[emulator, "--link", port, "--faults", faults, "--pace", pace], output="screen"),
        ]
    )
