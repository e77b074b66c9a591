# SPDX-License-Identifier: Apache-2.0
"""Nothing begins on a plant that was armed before all that will act is ready."""

from __future__ import annotations

import os
import pty
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import GAINS, STATE
from hydro_bridge.safety.arming import HOW_TO_ARM, TOO_EARLY
from hydro_bridge.signals import Flag
from tests.graph_probe import SHORT, Probe, trainer

pytestmark = pytest.mark.graph

AT_ONCE = 0.5
"""s from arming to the first gains: a tick and a policy step are 0.06 s, the rest is for a busy machine."""


@pytest.fixture
def typed() -> Iterator[tuple[int, int]]:
    """A terminal: where a person types, and where a program reads it."""
    ends = pty.openpty()
    yield ends
    for end in ends:
        os.close(end)


def test_a_plant_that_was_armed_before_the_trainer_came_waits_for_the_person_who_arms(
    probe: Probe, typed: tuple[int, int], tmp_path: Path
) -> None:
    words = ("--plant", "external", "--from", "scratch", "--runs", str(tmp_path), "--name", "run")
    with ExitStack() as graph:
        graph.enter_context(Companion("hydro_sim", "sim", ["--model", "analytic"]))
        graph.enter_context(Companion("hydro_filter", "filter"))
        probe.wait_for(STATE, lambda state: not state.flags & Flag.FILTER_STALE, 120.0)
        probe.arm(True)
        process = graph.enter_context(trainer(*words, *SHORT, stdin=typed[1]))
        probe.wait(lambda: "gains are sent under" in process.text, 60.0)
        os.write(typed[0], b"\n")
        probe.wait(lambda: "not armed, still waiting for" in process.text, 10.0)
        probe.wait(lambda: HOW_TO_ARM in process.text, 150.0)
        assert TOO_EARLY in process.text and not probe.flags() & Flag.ARMED
        probe.forget()
        probe.spin(1.0)
        assert probe.heard[STATE] and not probe.heard[GAINS], "nobody has armed it on purpose yet"
        os.write(typed[0], b"\n")
        probe.wait(lambda: bool(probe.flags() & Flag.ARMED), 10.0)
        probe.wait(lambda: bool(probe.heard[GAINS]), 5.0)
        armed = next(when for when, state in probe.heard[STATE] if state.flags & Flag.ARMED)
        assert probe.heard[GAINS][0][0] - armed < AT_ONCE
        assert process.end() == 130
    probe.spin(0.2)
