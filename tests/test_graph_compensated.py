# SPDX-License-Identifier: Apache-2.0
"""The compensated law over the serial line: what is left when its estimator is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import LAW_STATE, STATE, create_subscription
from hydro_bridge.serial.protocol import BoxLaw
from hydro_bridge.signals import NEUTRAL, SAMPLE_PERIOD, Flag
from hydro_msgs.msg import LawState
from hydro_policy.nodes.startup.companions import PlantOptions, start_companions
from hydro_policy.task.mdp import GainRange
from tests.graph_probe import Probe

pytestmark = pytest.mark.graph

LAW = BoxLaw()
PLANT = PlantOptions(plant="emulator")
STALE = 0.2
"""s, guard.gains_age_max."""
CURVATURE = 0.1
"""N by which a sine of 300 N and 2 Hz leaves its tangent within a sample, and single precision: 0.03 N."""


@pytest.fixture
def plant(probe: Probe, tmp_path: Path) -> Iterator[ExitStack]:
    with ExitStack() as stack:
        start_companions(stack, PLANT, GainRange(), tmp_path, print)
        probe.wait(lambda: probe.heard[STATE], 120.0)
        yield stack


def coefficients(states: list[LawState]) -> np.ndarray:
    return np.array([(state.a_0, state.a_1, state.a_2, state.a_3) for state in states])


def test_a_killed_estimator_leaves_neutral_coefficients_without_a_jump(
    plant: ExitStack, probe: Probe, tmp_path: Path
) -> None:
    heard: list[LawState] = []
    create_subscription(probe.node, LAW_STATE, heard.append)
    place = ("--runs", str(tmp_path), "--name", "run", "--no-dashboard")
    words = ("--law", "compensated", "--rearm", "auto", *place, "--frequencies", "2")
    estimating = plant.enter_context(Companion("hydro_policy", "evaluate", list(words)))
    probe.wait(lambda: heard and heard[-1].a_1 > 0.01, 150.0)
    probe.spin(0.5)
    os.kill(estimating.process.pid, signal.SIGKILL)
    begun = len(heard)
    probe.spin(2.5)
    assert probe.flags() & Flag.ARMED and not probe.flags() & Flag.TRIPPED
    after = heard[begun - 100 :]
    a, sequences = coefficients(after), np.array([state.sequence for state in after])
    whole = np.diff(sequences) == 1
    changes = np.abs(np.diff(a, axis=0))[whole] / SAMPLE_PERIOD
    assert (changes <= np.array(LAW.coefficient_rate) * 1.001 + 1e-3).all(), "no faster than the law's ramps"
    f_c = np.array([state.compensated_reference for state in after])
    rate = np.abs([state.compensated_reference_rate for state in after])
    steps = np.abs(np.diff(f_c))[whole] - SAMPLE_PERIOD * np.maximum(rate[1:], rate[:-1])[whole]
    assert steps.max() < CURVATURE, "f_c goes no other way than its derivative says"
    far = np.abs(a[100] - NEUTRAL) / LAW.coefficient_rate
    left = int((sequences[np.any(a != NEUTRAL, axis=1)][-1] - sequences[100]) & 0xFFFFFFFF) * SAMPLE_PERIOD
    assert STALE - 0.1 < left < STALE + far.max() + 0.5
    last = after[-1]
    assert (last.velocity_compensation, last.valve_gain_scale) == (LAW.velocity_compensation, LAW.valve_gain_scale)
    assert probe.last(STATE).proportional_gain == LAW.base_kp and probe.last(STATE).integral_gain == LAW.base_ki
