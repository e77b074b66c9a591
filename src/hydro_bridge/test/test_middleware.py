# SPDX-License-Identifier: Apache-2.0
"""A middleware that is not installed is one sentence, before anything of ROS says it in its own way."""

from __future__ import annotations

import os
import subprocess

import pytest

from hydro_bridge.process.start import RMW


def test_an_executable_ends_in_the_sentence() -> None:
    pytest.importorskip("rclpy")
    from hydro_bridge.ros.companion import executable_path

    done = subprocess.run(
        [str(executable_path("hydro_bridge", "arm"))],
        env=os.environ | {RMW: "rmw_nothing_cpp"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: RMW_IMPLEMENTATION is rmw_nothing_cpp, which is not installed")
