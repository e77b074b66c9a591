# SPDX-License-Identifier: Apache-2.0
"""A middleware that is not installed is one sentence, before anything of ROS says it in its own way."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from hydro_bridge.process.middleware import RMW, missing_middleware


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where one middleware is installed, beside what chooses among them."""
    index = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    index.mkdir(parents=True)
    for name in ("rmw_fastrtps_cpp", "rmw_implementation"):
        (index / name).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.delenv(RMW, raising=False)
    return tmp_path


def test_one_that_is_not_installed_is_told_with_those_that_are(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RMW, "rmw_nothing_cpp")
    assert missing_middleware() == (
        "RMW_IMPLEMENTATION is rmw_nothing_cpp, which is not installed: unset it, or take rmw_fastrtps_cpp"
    )


def test_one_that_is_there_and_the_default_are_taken(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_middleware() == ""
    monkeypatch.setenv(RMW, "rmw_fastrtps_cpp")
    assert missing_middleware() == ""


def test_an_executable_ends_in_the_sentence() -> None:
    pytest.importorskip("rclpy")
    from hydro_bridge.ros import executable_path

    done = subprocess.run(
        [str(executable_path("hydro_bridge", "arm"))],
        env=os.environ | {RMW: "rmw_nothing_cpp"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: RMW_IMPLEMENTATION is rmw_nothing_cpp, which is not installed")
