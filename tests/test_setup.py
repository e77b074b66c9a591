# SPDX-License-Identifier: Apache-2.0
"""The parts of the set-up; nothing here installs anything."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from setup import compile_kernels, host, kernels, plan, stamp, venv
from setup.layout import Layout

ROOT = Path(__file__).resolve().parent.parent


def fake_ros(prefix: Path, distribution: str) -> dict[str, str]:
    ros2 = prefix / "bin" / "ros2"
    ros2.parent.mkdir(parents=True)
    ros2.write_text("#!/bin/sh\n")
    ros2.chmod(0o755)
    return {"ROS_DISTRO": distribution, "AMENT_PREFIX_PATH": str(prefix), "PATH": f"{ros2.parent}:/usr/bin"}


def test_sourced_jazzy_is_used(tmp_path: Path) -> None:
    layout = Layout(root=tmp_path)
    environment = fake_ros(tmp_path / "jazzy", "jazzy")
    ros = host.sourced_ros(environment, layout.venv)
    assert ros == tmp_path / "jazzy"
    built_in = host.build_environment(environment, layout.venv, ros)
    assert built_in["AMENT_PREFIX_PATH"] == str(tmp_path / "jazzy")
    assert built_in["PATH"].startswith(f"{layout.venv}/bin:{tmp_path}/jazzy/bin")
    names = [path.name for path in venv.requirement_files(layout, with_ros=False, with_build_tools=False)]
    assert names == ["requirements.txt", "requirements-dev.txt"]


def test_stand_in_is_not_taken_for_a_sourced_ros(tmp_path: Path) -> None:
    assert host.sourced_ros(fake_ros(tmp_path / ".venv", "jazzy"), tmp_path / ".venv") is None
    assert host.sourced_ros({"PATH": "/usr/bin"}, tmp_path / ".venv") is None


def make_package(source: Path) -> Path:
    package = source / "rig"
    (package / "msg").mkdir(parents=True)
    (package / "launch").mkdir()
    (package / "rig").mkdir()
    for name in ("package.xml", "setup.py", "msg/State.msg", "launch/rig.launch.py", "rig/core.py"):
        (package / name).write_text("one")
    return package


@pytest.mark.parametrize(
    ("file", "rebuilds"),
    [
        ("package.xml", True),
        ("msg/State.msg", True),
        ("launch/rig.launch.py", False),
        ("rig/core.py", False),
    ],
)
def test_only_what_a_build_reads_calls_for_one(tmp_path: Path, file: str, rebuilds: bool) -> None:
    package = make_package(tmp_path)
    contents, names = stamp.package_inputs(tmp_path)
    before = stamp.digest(["same"], contents, names)
    (package / file).write_text("two")
    contents, names = stamp.package_inputs(tmp_path)
    assert (stamp.digest(["same"], contents, names) != before) is rebuilds


def compiled_checkout(root: Path) -> tuple[Layout, Path, Path]:
    """A layout whose one kernel was compiled: source and cache."""
    layout, source, cache = Layout(root=root), root / "kernel.py", root / "kernel.nbi"
    source.write_text("one")
    cache.touch()
    stat = source.stat()
    layout.kernels_stamp.parent.mkdir(parents=True)
    content = {"machine": "this", "sources": {str(source): [stat.st_mtime_ns, stat.st_size]}, "caches": [str(cache)]}
    layout.kernels_stamp.write_text(json.dumps(content))
    return layout, source, cache


def test_kernels_are_compiled_anew_where_a_source_a_cache_or_the_machine_changed(tmp_path: Path) -> None:
    layout, source, cache = compiled_checkout(tmp_path)
    assert kernels.are_current(layout, "this") and not kernels.are_current(layout, "that")
    cache.unlink()
    assert not kernels.are_current(layout, "this")
    cache.touch()
    source.write_text("another")
    assert not kernels.are_current(layout, "this")
    source.unlink()
    assert not kernels.are_current(layout, "this")
    layout.kernels_stamp.write_text("{")
    assert not kernels.are_current(layout, "this")


def test_every_package_with_kernels_is_compiled_at_set_up() -> None:
    sources = [path for path in ROOT.glob("src/hydro_*/hydro_*/**/*.py") if "@njit" in path.read_text()]
    assert sources
    compiled = {package.partition(".")[0] for package in compile_kernels.PACKAGES}
    assert compiled == {path.relative_to(ROOT / "src").parts[0] for path in sources}


def test_set_up_checkout_is_left_alone_and_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    command = [sys.executable, "-m", "setup.bootstrap"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 2.0, (
        "s of CPU, however busy the machine"
    )
    assert (answer.returncode, answer.stdout, answer.stderr) == (0, "", "")
    assert plan.HERE.root == ROOT
