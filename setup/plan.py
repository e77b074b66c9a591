# SPDX-License-Identifier: Apache-2.0
"""The order of the steps, and which of them are needed."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from setup import host, stamp, venv, wheels, workspace
from setup import kernels as compiling
from setup.layout import HERE, Layout
from setup.progress import Steps


def carry_out(layout: Layout = HERE, *, force: bool = False, kernels: bool = True) -> None:
    """Bring the checkout up to date; interrupted anywhere, the next call goes on, as a stamp follows its step.

    `force`: everything again. `kernels`: compile them, too.
    """
    ros = host.sourced_ros(os.environ, layout.venv)
    wheels_digest = _wheels_digest(layout, ros)
    build_digest = _build_digest(layout, wheels_digest)
    machine = compiling.machine_digest(wheels_digest)

    def needed() -> tuple[bool, bool, bool]:
        wheels_needed = not stamp.is_current(layout.wheels_stamp, wheels_digest)
        build_needed = wheels_needed or not stamp.is_current(layout.build_stamp, build_digest)
        return wheels_needed, build_needed, kernels and not compiling.are_current(layout, machine)

    if not force and not any(needed()):
        return
    with _alone(layout):
        if force:
            for path in (layout.wheels_stamp, layout.build_stamp, layout.kernels_stamp):
                path.unlink(missing_ok=True)
        wheels_needed, build_needed, kernels_needed = needed()
        steps = Steps(total=3 * wheels_needed + build_needed + kernels_needed)
        environment = host.build_environment(os.environ, layout.venv, ros)
        if wheels_needed:
            _make_environment(layout, ros, steps)
            stamp.write(layout.wheels_stamp, wheels_digest)
        if build_needed:
            with steps.step("build the packages with colcon"):
                workspace.build(layout, environment)
                stamp.write(layout.build_stamp, build_digest)
        if kernels_needed:
            with steps.step("compile the kernels (minutes, where nothing is compiled yet)"):
                compiling.compile_all(layout, machine, environment)
    print("hydro is set up: `source install/setup.bash`, then for example `ros2 run hydro_policy trainer --help`.")


def _make_environment(layout: Layout, ros: Path | None, steps: Steps) -> None:
    host.require_tools(ros)
    with_system = ros is not None
    with steps.step(f"environment .venv on Python {sys.version.split()[0]}" + (f", ROS 2 of {ros}" if ros else "")):
        if not venv.is_usable(layout, with_system):
            workspace.forget(layout)
            venv.create(layout, with_system)
    with steps.step("install the pinned wheels (a minute or two)"):
        with_build_tools = ros is None or not _brings_colcon(layout)
        venv.install(layout, venv.requirement_files(layout, ros is None, with_build_tools))
    with steps.step("adapt the ROS wheels" if ros is None else "take ros2 as it is"):
        if ros is None:
            wheels.repair_include_paths(layout.venv, *wheels.include_folders(layout))
            wheels.write_local_setup(layout)
            wheels.install_stand_in(layout)


def _brings_colcon(layout: Layout) -> bool:
    probe = [str(layout.python), "-c", "import colcon_core, colcon_ros"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


def _wheels_digest(layout: Layout, ros: Path | None) -> str:
    pins = [*layout.root.glob("requirements*.txt"), layout.root / "constraints.txt"]
    words = [f"python {sys.version}", f"base {sys.base_prefix}", f"ros {ros}", f"at {layout.root}"]
    return stamp.digest(words, [*pins, *(layout.root / "setup").glob("*.py")])


def _build_digest(layout: Layout, wheels_digest: str) -> str:
    contents, names = stamp.package_inputs(layout.root / "src")
    firmware = [path for pattern in ("*.*", "hydro/*.h") for path in (layout.root / "firmware").glob(pattern)]
    return stamp.digest([wheels_digest], [*contents, *firmware, layout.root / "colcon.meta"], names)


@contextmanager
def _alone(layout: Layout) -> Iterator[None]:
    layout.lock.parent.mkdir(parents=True, exist_ok=True)
    with layout.lock.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("another set-up is at work here; waiting for it ...", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield
