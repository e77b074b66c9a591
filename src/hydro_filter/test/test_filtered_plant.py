# SPDX-License-Identifier: Apache-2.0
"""A plant with the filter in its process: who fails in it, and what the plant does then."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
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


@pytest.fixture
def failing(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], Probe]]]:
    @contextmanager
    def begin(**words: object) -> Iterator[tuple[subprocess.Popen[str], Probe]]:
        with own_domain():
            said = (tmp_path / "said").open("w+")
            process = subprocess.Popen(
                [sys.executable, "-c", FAILS.format(trigger=tmp_path / "fail", **words)], stdout=said, stderr=said
            )
            probe = Probe()
            try:
                yield process, probe
            finally:
                process.kill()
                process.wait()
                probe.close()

    yield begin


def test_a_filter_that_raises_is_asked_no_more_and_the_plant_goes_to_base_gains(failing, tmp_path: Path) -> None:
    words = {"module": "hydro_filter.controller.loop_filter", "name": "LoopFilter", "method": "correct"}
    with failing(**words) as (process, probe):
        probe.wait(lambda: probe.node.count_publishers(CORRECTION) == 1, 60.0)
        probe.take()
        probe.arm(True)
        probe.drive_to(75.0, 10.0, 90.0)
        (tmp_path / "fail").touch()
        probe.wait(lambda: "the filter failed" in (tmp_path / "said").read_text(), 20.0)
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


def test_a_plant_whose_thread_fails_ends_its_node_with_the_error(failing, tmp_path: Path) -> None:
    words = {"module": "hydro_sim.simulation.realtime", "name": "Simulation", "method": "_show"}
    with failing(**words) as (process, probe):
        probe.wait(lambda: len(probe.states) > 100, 60.0)
        (tmp_path / "fail").touch()
        probe.wait(lambda: process.poll() is not None, 60.0)
        assert process.returncode == 1 and probe.states
    assert "ArithmeticError: a defect" in (tmp_path / "said").read_text()
