# SPDX-License-Identifier: Apache-2.0
"""The parts of the set-up, its stand-in for `ros2` among them; nothing here installs anything."""

from __future__ import annotations

import json
import os
import resource
import shlex
import sys
from pathlib import Path

import pytest

from setup import environment, ros2, steps
from setup.bootstrap import complaint
from setup.environment import SetupError
from tests.checks import ran

ROOT = Path(__file__).resolve().parent.parent


def fake_ros(prefix: Path) -> dict[str, str]:
    ros2 = prefix / "bin" / "ros2"
    ros2.parent.mkdir(parents=True)
    ros2.write_text("#!/bin/sh\n")
    ros2.chmod(0o755)
    return {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(prefix), "PATH": f"{ros2.parent}:/usr/bin"}


def test_a_python_or_a_folder_that_cannot_be_used_is_refused_in_a_sentence() -> None:
    for version, folder, sentence in (
        ((3, 9, 1), "/home/l/hydro", "Python 3.9 found, but 3.10 to 3.13 is needed"),
        ((3, 14, 0), "/home/l/hydro", "Python 3.14 found, but 3.10 to 3.13 is needed"),
        ((3, 12, 3), "/home/jürgen/hydro", "/home/jürgen/hydro has letters outside of ASCII"),
    ):
        assert complaint(version, folder).startswith(sentence)
    assert complaint((3, 10, 0), "/home/l/hydro") is None and complaint((3, 13, 9), "/home/l/hydro") is None


def test_sourced_jazzy_is_used_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "VENV", own := tmp_path / ".venv")
    sourced = fake_ros(tmp_path / "jazzy")
    ros = environment.sourced_ros(sourced)
    assert ros == tmp_path / "jazzy"
    built_in = environment.variables(sourced, ros)
    assert built_in["AMENT_PREFIX_PATH"] == str(tmp_path / "jazzy")
    assert built_in["PATH"].startswith(f"{own}/bin:{tmp_path}/jazzy/bin")
    assert environment.variables(sourced | {"PYTHONPATH": "/else"}, None).keys() & environment.FOREIGN == {
        "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"
    }  # fmt: skip
    assert environment.sourced_ros(fake_ros(own)) is None, "the stand-in"
    assert environment.sourced_ros({"PATH": "/usr/bin"}) is None
    with pytest.raises(SetupError, match="ROS 2 humble is sourced: source Jazzy"):
        environment.sourced_ros(sourced | {"ROS_DISTRO": "humble"})


def test_only_what_a_build_reads_calls_for_one(tmp_path: Path) -> None:
    files = {"package.xml": True, "msg/State.msg": True, "launch/rig.launch.py": False, "rig/core.py": False}
    for name in files:
        (tmp_path / "rig" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "rig" / name).write_text("one")
    for name, rebuilds in files.items():
        before = steps.digest(["same"], steps.package_inputs(tmp_path))
        (tmp_path / "rig" / name).write_text("two")
        assert (steps.digest(["same"], steps.package_inputs(tmp_path)) != before) is rebuilds, name


def test_kernels_are_compiled_anew_where_a_source_or_the_machine_changed(tmp_path: Path) -> None:
    source, stamp = tmp_path / "kernel.py", tmp_path / "kernels.json"
    source.write_text("one")
    stat = source.stat()
    stamp.write_text(json.dumps({"machine": "this", "sources": {str(source): [stat.st_mtime_ns, stat.st_size]}}))
    assert steps.is_compiled(stamp, "this") and not steps.is_compiled(stamp, "that")
    for spoil in (lambda: source.write_text("another"), source.unlink, lambda: stamp.write_text("{"), stamp.unlink):
        spoil()
        assert not steps.is_compiled(stamp, "this")


def test_uv_is_configured_as_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("UV_FIND_LINKS", "UV_INDEX", "UV_DEFAULT_INDEX", "SSL_CERT_FILE"):
        monkeypatch.delenv(name, raising=False)
    configured = {"CONFIG_FILE": os.devnull, "FIND_LINKS": "/one /two", "INDEX_URL": "file:///mirror", "CERT": "/c.pem"}
    for name, value in configured.items():
        monkeypatch.setenv(f"PIP_{name}", value)
    found = environment.with_pip_configuration(os.environ)
    uv = {"UV_FIND_LINKS": "/one,/two", "UV_DEFAULT_INDEX": "file:///mirror", "SSL_CERT_FILE": "/c.pem"}
    assert found == found | uv
    monkeypatch.setenv("UV_FIND_LINKS", "/three")
    assert environment.with_pip_configuration(os.environ)["UV_FIND_LINKS"] == "/three", "its own setting counts"


def test_a_wheel_in_the_cache_of_uv_stays_as_it_is(tmp_path: Path) -> None:
    cached, linked = tmp_path / "cached.cmake", tmp_path / "venv" / "share" / "rig" / "cmake" / "rig.cmake"
    cached.write_text(built := "/opt/python/cp311-cp311/include/python3.11")
    linked.parent.mkdir(parents=True)
    linked.hardlink_to(cached)
    environment.repair_include_paths(tmp_path / "venv", "/python", "/numpy")
    assert (linked.read_text(), cached.read_text()) == ("/python", built)


def test_an_environment_is_made_anew_where_its_filling_was_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros = environment.sourced_ros(os.environ)
    assert environment.is_usable(ros) and not environment.is_usable(None if ros else tmp_path)
    monkeypatch.setattr(environment, "INSTALLING", tmp_path)
    assert not environment.is_usable(ros)


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
        ("launch hydro_policy graph.launch.py", "`ros2 launch hydro_policy` needs a full ROS 2 Jazzy"),
        ("topic pub /hydro/state", "`ros2 topic pub` needs a full ROS 2 Jazzy"),
    ],
)
def test_what_the_stand_in_cannot_do_it_says_in_a_sentence(
    words: str, sentence: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [])
    try:
        status = ros2.main(shlex.split(words))
    except SystemExit as ended:
        status = int(ended.code or 0)
    printed = capfd.readouterr()
    assert (status, printed.out) == (2, "")
    assert sentence in printed.err and printed.err.count("\n") == 1, printed.err
