# SPDX-License-Identifier: Apache-2.0
"""The parts of the set-up, its stand-in for `ros2` among them; nothing here installs anything."""

from __future__ import annotations

import json
import os
import resource
import shlex
import sys
import threading
from pathlib import Path

import pytest

from setup import compile_kernels, host, kernels, plan, ros2, stamp, venv, wheels
from setup.layout import Layout
from setup.progress import SetupError
from tests.checks import ran

ROOT = Path(__file__).resolve().parent.parent


def fake_ros(prefix: Path) -> dict[str, str]:
    ros2 = prefix / "bin" / "ros2"
    ros2.parent.mkdir(parents=True)
    ros2.write_text("#!/bin/sh\n")
    ros2.chmod(0o755)
    return {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(prefix), "PATH": f"{ros2.parent}:/usr/bin"}


def test_sourced_jazzy_is_used_and_no_other(tmp_path: Path) -> None:
    environment, own = fake_ros(tmp_path / "jazzy"), Layout(root=tmp_path).venv
    ros = host.sourced_ros(environment, own)
    assert ros == tmp_path / "jazzy"
    built_in = host.build_environment(environment, own, ros)
    assert built_in["AMENT_PREFIX_PATH"] == str(tmp_path / "jazzy")
    assert built_in["PATH"].startswith(f"{own}/bin:{tmp_path}/jazzy/bin")
    assert host.sourced_ros(fake_ros(own), own) is None, "the stand-in"
    assert host.sourced_ros({"PATH": "/usr/bin"}, own) is None
    with pytest.raises(SetupError, match="ROS 2 humble is sourced, but hydro needs Jazzy"):
        host.sourced_ros(environment | {"ROS_DISTRO": "humble"}, own)


def test_only_what_a_build_reads_calls_for_one(tmp_path: Path) -> None:
    files = {"package.xml": True, "msg/State.msg": True, "launch/rig.launch.py": False, "rig/core.py": False}
    for name in files:
        (tmp_path / "rig" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "rig" / name).write_text("one")
    for name, rebuilds in files.items():
        before = stamp.digest(["same"], *stamp.package_inputs(tmp_path))
        (tmp_path / "rig" / name).write_text("two")
        assert (stamp.digest(["same"], *stamp.package_inputs(tmp_path)) != before) is rebuilds, name


def test_kernels_are_compiled_anew_where_a_source_a_cache_or_the_machine_changed(tmp_path: Path) -> None:
    layout, source, cache = Layout(root=tmp_path), tmp_path / "kernel.py", tmp_path / "kernel.nbi"
    source.write_text("one")
    cache.touch()
    stat = source.stat()
    content = {"machine": "this", "sources": {str(source): [stat.st_mtime_ns, stat.st_size]}, "caches": [str(cache)]}
    written, main_job = layout.kernels_stamp(False), layout.kernels_stamp(True)
    written.parent.mkdir(parents=True)
    written.write_text(json.dumps(content))
    assert kernels.are_current(layout, "this", False) and not kernels.are_current(layout, "that", False)
    assert kernels.are_current(layout, "this", True), "all kernels are the main job's too"
    written.rename(main_job)
    assert kernels.are_current(layout, "this", True) and not kernels.are_current(layout, "this", False)
    for spoil in (cache.unlink, lambda: source.write_text("another"), source.unlink, lambda: main_job.write_text("{")):
        spoil()
        assert not kernels.are_current(layout, "this", True)
        cache.touch()


def test_what_is_compiled_at_set_up_is_all_that_has_kernels() -> None:
    sources = [path for path in ROOT.glob("src/hydro_*/hydro_*/**/*.py") if "@njit" in path.read_text()]
    assert sources
    packages = {path.relative_to(ROOT / "src").parts[0] for path in sources}
    assert set(compile_kernels.PACKAGES) == packages | {"hydro_filter"}, "whose models are compiled, too"
    for package, step in compile_kernels.MAIN_JOB:
        assert f'"{step}":' in (ROOT / "src" / package / package / "precompile.py").read_text()


def test_uv_is_configured_as_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("UV_FIND_LINKS", "UV_INDEX", "UV_DEFAULT_INDEX", "SSL_CERT_FILE"):
        monkeypatch.delenv(name, raising=False)
    configured = {"CONFIG_FILE": os.devnull, "FIND_LINKS": "/one /two", "INDEX_URL": "file:///mirror", "CERT": "/c.pem"}
    for name, value in configured.items():
        monkeypatch.setenv(f"PIP_{name}", value)
    found = venv.uv_environment(Layout(root=ROOT))
    uv = {"UV_FIND_LINKS": "/one,/two", "UV_DEFAULT_INDEX": "file:///mirror", "SSL_CERT_FILE": "/c.pem"}
    assert found == found | uv
    monkeypatch.setenv("UV_FIND_LINKS", "/three")
    assert venv.uv_environment(Layout(root=ROOT))["UV_FIND_LINKS"] == "/three", "its own setting counts"


def test_a_wheel_in_the_cache_of_uv_stays_as_it_is(tmp_path: Path) -> None:
    cached, linked = tmp_path / "cached.cmake", tmp_path / "venv" / "share" / "rig" / "cmake" / "rig.cmake"
    cached.write_text("/opt/python/cp311-cp311/include/python3.11")
    linked.parent.mkdir(parents=True)
    linked.hardlink_to(cached)
    assert wheels.repair_include_paths(tmp_path / "venv", "/python", "/numpy") == 1
    assert (linked.read_text(), cached.read_text()) == ("/python", "/opt/python/cp311-cp311/include/python3.11")


def test_a_failed_step_leaves_out_what_waits_beside_it() -> None:
    begun, released = threading.Event(), threading.Event()

    def build() -> None:
        begun.set()
        released.wait(10)

    with pytest.raises(SetupError), plan._beside() as beside:
        beside.submit(build)
        waiting = beside.submit(build)
        assert begun.wait(10)
        threading.Timer(0.2, released.set).start()
        raise SetupError("no network")
    assert waiting.cancelled()


def test_set_up_checkout_is_left_alone_and_at_once() -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer = ran(sys.executable, "-m", "setup.bootstrap", "--checks", cwd=ROOT, timeout=60)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert took < 2.0, "s of CPU, however busy the machine"
    assert (answer.returncode, answer.stdout, answer.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run nothing echo", "package 'nothing' not found"),
        ("run hydro_sim si", "no executable 'si'; it has: emulator, "),
        ("doctor", "`ros2 doctor` needs a full ROS 2 Jazzy"),
        ("service call /hydro/arm std_srvs/srv/SetBool '{dat: 1}'", "has no field dat; it has: data"),
        ("service call /hydro/arm std_srvs/srv/SetBool '{data: 1}'", "data: 1 is no boolean"),
        ("bag info /nothing", "/nothing does not exist"),
        ("launch hydro_bridge bridge.launch.py", "port:= is needed: serial device of the box"),
        ("launch hydro_policy train.launch.py plant:=moon", "sim, emulator, bench can be chosen"),
        ("launch hydro_policy train.launch.py sed:=3", "sed:= is no argument of train.launch.py; is seed:= meant?"),
        ("launch hydro_sim sim.launch.py bench:=x", "bench:= is no argument of sim.launch.py; it has: pace:=, "),
    ],
)
def test_what_the_stand_in_cannot_do_it_says_in_a_sentence(
    words: str, sentence: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, whose modules of `launch` and arguments stay as they were."""
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    monkeypatch.setattr(sys, "argv", [])
    try:
        status = ros2.main(shlex.split(words))
    except SystemExit as ended:
        status = int(ended.code or 0)
    printed = capfd.readouterr()
    assert (status, printed.out) == (2, "")
    assert sentence in printed.err and printed.err.count("\n") == 1, printed.err
