# SPDX-License-Identifier: Apache-2.0
"""The order of the steps, and which of them are needed."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

from setup import host, stamp, venv, wheels, workspace
from setup import kernels as compiling
from setup.layout import HERE, Layout
from setup.progress import Steps


@dataclass(frozen=True)
class Digests:
    """What each part is made from."""

    wheels: str
    checks: str
    build: str
    machine: str


@dataclass(frozen=True)
class Needed:
    """What is not up to date: wheels of all programs, of checks and tests, built packages, kernels."""

    wheels: bool
    checks: bool
    build: bool
    kernels: bool


def carry_out(layout: Layout = HERE, *, force: bool = False, checks: bool = False, kernels: str = "all") -> None:
    """Bring the checkout up to date; interrupted anywhere, the next call goes on, as a stamp follows its step.

    `force`: everything again. `checks`: install what checks and tests need on top. `kernels`: compile "none", those of
    the "main-job" or "all".
    """
    ros = host.sourced_ros(os.environ, layout.venv)
    digests = _digests(layout, ros)
    if not force and not any(astuple(_needed(layout, digests, checks, kernels))):
        return
    with _alone(layout), Steps() as steps:
        if force:
            stamps = (layout.wheels_stamp, layout.checks_stamp, layout.build_stamp)
            for path in (*stamps, *map(layout.kernels_stamp, (True, False))):
                path.unlink(missing_ok=True)
        needed = _needed(layout, digests, checks, kernels)
        with _beside() as beside:
            _make(layout, ros, digests, needed, kernels == "main-job", steps, beside)
        rest = ", and `make setup` compiles the other programs' kernels" if kernels == "main-job" else ""
        steps.say(f"hydro is set up: `source install/setup.bash` in a shell of your own{rest}.")


def _make(
    layout: Layout,
    ros: Path | None,
    digests: Digests,
    needed: Needed,
    main_job: bool,
    steps: Steps,
    beside: ThreadPoolExecutor,
) -> None:
    """Make what is needed. Colcon builds beside downloads and kernels, of which these wait for the box's C code."""
    environment = host.build_environment(os.environ, layout.venv, ros)

    def build(title: str, packages: Sequence[str] = ()) -> None:
        log = layout.log("-".join(("build", *packages)))
        with steps.step(title, log):
            workspace.build(layout, environment, packages, log)
        if not packages:
            stamp.write(layout.build_stamp, digests.build)

    if needed.wheels:
        _make_environment(layout, ros, steps)
    builds: list[Future[None]] = []
    if needed.build:
        workspace.link_sources(layout)
        builds = [
            beside.submit(build, "C code of the box", ("hydro_firmware",)),
            beside.submit(build, "messages and packages"),
        ]
    if needed.wheels:
        _install(layout, steps, "wheels", "wheels of all programs", ["requirements.txt"])
        stamp.write(layout.wheels_stamp, digests.wheels)
    if needed.checks:
        _install(layout, steps, "wheels-checks", "wheels of checks and tests", ["requirements-dev.txt"])
        stamp.write(layout.checks_stamp, digests.checks)
    for box in builds[:1]:
        box.result()
    if needed.kernels:
        log = layout.log("kernels")
        with steps.step("kernels of the main job" if main_job else "all kernels (minutes)", log):
            compiling.compile_steps(layout, digests.machine, environment, main_job, log)
    for packages in builds[1:]:
        packages.result()


def _make_environment(layout: Layout, ros: Path | None, steps: Steps) -> None:
    """Make the environment, with what the packages are built with."""
    host.require_tools(ros)
    with_system, log = ros is not None, layout.log("venv")
    title = f"environment .venv on Python {sys.version.split()[0]}" + (f", ROS 2 of {ros}" if ros else "")
    with steps.step(title, log):
        if not venv.is_usable(layout, with_system):
            workspace.forget(layout)
            venv.create(layout, with_system, log)
        venv.install_uv(layout, log)
    files = ["requirements-ros.txt"] if ros is None else []
    files += ["requirements-build.txt"] if ros is None or not _brings_colcon(layout) else []
    _install(layout, steps, "wheels-build", "wheels to build with", ["numpy", *files])
    if ros is None:
        wheels.repair_include_paths(layout.venv, *wheels.include_folders(layout))
        wheels.write_local_setup(layout)
        wheels.install_stand_in(layout)


def _install(layout: Layout, steps: Steps, name: str, title: str, requirements: Sequence[str]) -> None:
    log = layout.log(name)
    with steps.step(title, log):
        venv.install(layout, requirements, log)
    megabytes, seconds = venv.downloads(log)
    if megabytes:
        steps.say(f"  of this {seconds:.0f} s to download and unpack {megabytes:.0f} MB (wheels above 1 MiB)")


def _needed(layout: Layout, digests: Digests, checks: bool, kernels: str) -> Needed:
    wheels_needed = not stamp.is_current(layout.wheels_stamp, digests.wheels)
    return Needed(
        wheels=wheels_needed,
        checks=checks and not stamp.is_current(layout.checks_stamp, digests.checks),
        build=wheels_needed or not stamp.is_current(layout.build_stamp, digests.build),
        kernels=kernels != "none" and not compiling.are_current(layout, digests.machine, kernels == "main-job"),
    )


def _brings_colcon(layout: Layout) -> bool:
    probe = [str(layout.python), "-c", "import colcon_core, colcon_ros"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


def _digests(layout: Layout, ros: Path | None) -> Digests:
    words = [f"python {sys.version}", f"base {sys.base_prefix}", f"ros {ros}", f"at {layout.root}"]
    pins = [layout.root / name for name in ("requirements-setup.txt", *venv.PINS) if name != "requirements-dev.txt"]
    of_wheels = stamp.digest(words, [*pins, *(layout.root / "setup").glob("*.py")])
    contents, names = stamp.package_inputs(layout.root / "src")
    firmware = [path for pattern in ("*.*", "hydro/*.h") for path in (layout.root / "firmware").glob(pattern)]
    return Digests(
        wheels=of_wheels,
        checks=stamp.digest([of_wheels], [layout.root / "requirements-dev.txt"]),
        build=stamp.digest([of_wheels], [*contents, *firmware, layout.root / "colcon.meta"], names),
        machine=compiling.machine_digest(of_wheels),
    )


@contextmanager
def _beside() -> Iterator[ThreadPoolExecutor]:
    """A thread beside this one; where this one fails, what has not begun there is left out."""
    with ThreadPoolExecutor(1) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


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
