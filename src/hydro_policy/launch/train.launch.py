# SPDX-License-Identifier: Apache-2.0
"""The whole graph: a plant, the filter, the recorder, the trainer.

`ros2 launch hydro_policy train.launch.py plant:=sim|emulator|bench [port:=/dev/ttyUSB0] [out:=runs/launched]
[seed:=0] [dashboard:=true]`. When the trainer ends, so does everything else. On the bench it waits until
somebody arms: `ros2 run hydro_bridge arm`.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from hydro_bridge.ros.launch_arguments import refuse_unknown_arguments
from hydro_sim.emulator.line.terminal import default_link


def include(package: str, name: str, **arguments: str) -> IncludeLaunchDescription:
    path = PathJoinSubstitution([FindPackageShare(package), "launch", f"{name}.launch.py"])
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(path), launch_arguments=arguments.items())


def plant(kind: str, port: str) -> list[LaunchDescriptionEntity]:
    """One of the three interchangeable sources of /hydro/state."""
    if kind == "sim":
        return [include("hydro_sim", "sim")]
    if kind == "emulator":
        port = port or str(default_link())
        return [include("hydro_sim", "emulator", port=port), include("hydro_bridge", "bridge", port=port)]
    if not port:
        raise RuntimeError("plant:=bench needs port:=, the serial device of the box")
    return [include("hydro_bridge", "bridge", port=port)]


def recorder(kind: str, out: Path, seed: str) -> Node:
    """Bench and digest are in the recording as the box says them, on /hydro/box."""
    words = ["--realtime", "--out", str(out / "bag"), "--metadata", f"run={out.name}", f"plant={kind}", f"seed={seed}"]
    return Node(package="hydro_bridge", executable="recorder", arguments=words, output="screen")


def trainer(kind: str, out: Path, seed: str) -> Node:
    run = ["--runs", str(out.parent), "--name", out.name, "--seed", seed]
    return Node(
        package="hydro_policy",
        executable="trainer",
        arguments=["--plant", "external", "--rearm", "ask" if kind == "bench" else "auto", "--no-dashboard", *run],
        output="screen",
        emulate_tty=True,
        sigterm_timeout="30",  # on Ctrl-C: it disarms, and writes what was learnt
        on_exit=Shutdown(reason="the trainer has ended"),
    )


def graph(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    kind, port, out, seed = (LaunchConfiguration(name).perform(context) for name in ("plant", "port", "out", "seed"))
    run = (kind, Path(out), seed)
    return [*plant(kind, port), include("hydro_filter", "filter"), recorder(*run), trainer(*run)]


def generate_launch_description() -> LaunchDescription:
    refuse_unknown_arguments(__file__, ("plant", "port", "out", "seed", "dashboard", "metric", "faults", "pace"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("plant", default_value="emulator", choices=["sim", "emulator", "bench"]),
            DeclareLaunchArgument("port", default_value="", description="serial device of the box"),
            DeclareLaunchArgument("out", default_value="runs/launched", description="folder of the run, made here"),
            DeclareLaunchArgument("seed", default_value="0", description="of the trainer"),
            OpaqueFunction(function=graph),
        ]
    )
