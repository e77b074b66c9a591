# SPDX-License-Identifier: Apache-2.0
"""The nodes of a graph's file: `ros2 launch hydro_policy graph.launch.py graph:=FILE`.

FILE is a ROS parameter file with a section for each node, as a run writes it (RUN/graph.yaml), or one of sim.yaml,
emulator.yaml and bench.yaml beside this file, to be copied. When the trainer ends, so does everything else.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration

from hydro_bridge.arguments import sections
from hydro_bridge.ros.companion import executable_path
from hydro_core.settings import read_yaml
from hydro_policy.nodes.plants import executables


def nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    file = Path(LaunchConfiguration("graph").perform(context))
    file = file if file.exists() else Path(__file__).with_name(file.name)
    graph = {name.strip("/"): values for name, values in sections(read_yaml(file))}
    return [
        ExecuteProcess(
            cmd=[str(executable_path(package, executable)), *words, "--ros-args", "--params-file", str(file)],
            output="screen",
            sigterm_timeout="30",  # on Ctrl-C a trainer disarms, and writes what was learnt
            on_exit=Shutdown(reason="the trainer has ended") if name == "trainer" else None,
        )
        for name, (package, executable, *words) in executables(graph).items()
    ]


def generate_launch_description() -> LaunchDescription:
    graph = DeclareLaunchArgument("graph", description="parameters of all nodes, a section each")
    return LaunchDescription([graph, OpaqueFunction(function=nodes)])
