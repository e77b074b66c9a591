# SPDX-License-Identifier: Apache-2.0
"""A plant with the filter in its process: who fails in it, and what the plant does then."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.topics import CORRECTION
from hydro_core.signals import Flag
from tests.domains import own_domain
from tests.graph_probe import Probe

pytestmark = pytest.mark.graph

FAILS = """
import os, sys
from {module} import {name} as failing
before = failing.{method}
def fails(*arguments):
    if os.path.exists("{trigger}"):
        raise ArithmeticError("a defect")
    return before(*arguments)
failing.{method} = fails
from hydro_filter.nodes.filtered_plant import main
sys.argv = ["filtered_plant", "sim", "--pace", "real"]
main()
"""
"""A simulation with its filter, of which one method fails once a file is there: at no time that a test must keep."""


@contextmanager
def failing(folder: Path, module: str, name: str, method: str) -> Iterator[tuple[subprocess.Popen[bytes], Probe]]:
    """The process, which fails once `folder`/fail is there and prints to `folder`/said, and who listens to it."""
    program = FAILS.format(module=module, name=name, method=method, trigger=folder / "fail")
    with own_domain(), (folder / "said").open("w+") as said:
        process, probe = subprocess.Popen([sys.executable, "-c", program], stdout=said, stderr=said), Probe()
        try:
            yield process, probe
        finally:
            process.kill()
            process.wait()
            probe.close()


def test_a_filter_that_raises_is_asked_no_more_and_the_plant_goes_to_base_gains(tmp_path: Path) -> None:
    with failing(tmp_path, "hydro_filter.controller.loop_filter", "LoopFilter", "correct") as (process, probe):
        probe.wait(lambda: probe.node.count_publishers(CORRECTION) == 1, 60.0)
        probe.take()
        probe.arm(True)
        probe.drive_to(75.0, 10.0, 90.0)
        (tmp_path / "fail").touch()
        probe.wait(lambda: "the filter failed" in (tmp_path / "said").read_text())
        probe.drive_to(75.0, 10.0, 15.0)
        probe.drive(75.0, 10.0, 0.5)
        probe.forget()
        probe.drive(75.0, 10.0, 0.5)
        assert {state.proportional_gain for state in probe.states} == {15.0}
        assert {state.valve_current - state.nominal_valve_current for state in probe.states} == {0.0}
        assert all(state.flags & Flag.FILTER_STALE for state in probe.states)
        assert process.poll() is None
    said = (tmp_path / "said").read_text()
    assert "[FATAL]" in said and "ArithmeticError: a defect" in said


def test_a_plant_whose_thread_fails_ends_its_node_with_the_error(tmp_path: Path) -> None:
    with failing(tmp_path, "hydro_sim.simulation.realtime", "Simulation", "_update_flags") as (process, probe):
        probe.wait(lambda: len(probe.states) > 100, 60.0)
        (tmp_path / "fail").touch()
        assert process.wait(60.0) == 1
    assert "ArithmeticError: a defect" in (tmp_path / "said").read_text()
