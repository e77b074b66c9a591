# SPDX-License-Identifier: Apache-2.0
"""What the gates of a commissioning read off recordings: a right bench passes, each mistake has its sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import Flag, FloatArray, ReferenceSignal, StateArray, Waveform
from hydro_filter.controller.loop_filter import default_filter
from hydro_policy.commissioning import checks
from hydro_policy.commissioning.record import GateError
from hydro_policy.task.cases import Score
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()


def recorded(amplitude: float) -> StateArray:
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=0.5)
    return simulate(AnalyticPlant(BENCH), BENCH, Schedule(reference=signal, gains=(75.0, 10.0), seconds=6.0), seed=1)


REST, MOTION = recorded(0.0), recorded(60.0)


MISTAKES: tuple[tuple[str, Callable[[StateArray], dict[str, FloatArray]]], ...] = (
    ("differs from the pressures", lambda at: {"pressure_a": at["pressure_b"], "pressure_b": at["pressure_a"]}),
    ("is stuck", lambda at: {"load_force": at["load_force"][0]}),
    ("differs from the pressures", lambda at: {"pressure_a": 1e-5 * at["pressure_a"]}),
    ("load force and its reference", lambda at: {"load_force": -at["load_force"]}),
    ("velocity and position", lambda at: {"piston_velocity": -at["piston_velocity"]}),
)
"""What is said, and which readings are others: three at rest, two in motion."""


def test_a_right_bench_passes() -> None:
    noise, off = checks.sensor_noise(REST, BENCH)
    assert noise["load_force"] == pytest.approx(0.6, rel=0.1) and abs(off) < 1.0
    creeping = REST.copy()
    creeping["load_force"] += 0.4 * creeping["time"]
    assert checks.creep(creeping) - checks.creep(REST) == pytest.approx(0.4)
    assert checks.drift_warning(creeping, 300.0) == ""
    creeping["load_force"] += 6.0 * creeping["time"]
    assert "crept by 6.4 N/s: null the valve" in checks.drift_warning(creeping, 300.0)
    creeping["load_force"] = 800.0 + REST["load_force"]
    assert "stood at 800 N" in checks.drift_warning(creeping, 300.0)
    assert min(checks.channel_correlations(MOTION[1000:], BENCH).values()) > checks.FOLLOWS


def test_a_reading_at_rest_that_cannot_be_and_a_sign_are_told() -> None:
    for number, (sentence, mistake) in enumerate(MISTAKES):
        right = REST if number < 3 else MOTION[1000:]
        states = right.copy()
        for name, values in mistake(right).items():
            states[name] = values
        with pytest.raises(GateError, match=sentence):
            (checks.sensor_noise if number < 3 else checks.channel_correlations)(states, BENCH)


def test_a_force_that_an_overlap_holds_back_still_follows_and_a_valve_that_hangs_is_told() -> None:
    states = MOTION[1000:].copy()
    states["load_force"] = 0.6 * np.roll(states["reference_force"], 300)
    assert checks.channel_correlations(MOTION[1000:], BENCH)["load force and its reference"] > checks.FOLLOWS
    checks.require_tracking(states, 0.5)
    states["load_force"] *= 0.1
    with pytest.raises(GateError, match="times the swing"):
        checks.require_tracking(states, 0.5)


def test_lost_samples_and_late_commands_count() -> None:
    states = MOTION[:1000].copy()
    states["flags"] = Flag.ARMED
    assert checks.unusable_share(states) == 0.0
    states["flags"][:20] = Flag.ARMED | Flag.FILTER_STALE
    assert checks.unusable_share(states) == pytest.approx(0.02)
    kept = states[states["sequence"] % 50 != 3]
    assert checks.unusable_share(kept) == pytest.approx(0.04, abs=5e-3)
    with pytest.raises(GateError, match="lost"):
        checks.sample_loss(kept, 1.0)


def test_of_an_evaluation_single_late_runs_do_not_count_and_many_do() -> None:
    run = Score(controller="any", case="1 Hz", frequency=1.0, repeat=0, samples=3000)
    stopped = replace(run, samples=0, stopped="tripped")
    assert checks.disturbed_share([replace(run, lost=20), stopped, replace(run, held=40)]) == pytest.approx(0.01)
    assert checks.disturbed_share([stopped]) == 0.0


def test_a_model_that_is_not_this_bench_is_told_before_the_valve_moves_behind_its_filter() -> None:
    checks.require_matching_filter(MOTION, default_filter(BENCH))
    other = MOTION.copy()
    other["load_force"] *= 1.3
    with pytest.raises(GateError, match="spring or its load cell"):
        checks.require_matching_filter(other, default_filter(BENCH))


def test_a_piston_that_stands_is_no_exchanged_channel_and_is_moved_further() -> None:
    states = MOTION[1000:].copy()
    states["piston_position"], states["load_force"] = 0.05, 0.0
    assert checks.is_motion_blocked(states)
    with pytest.raises(GateError, match="the piston did not move under currents up to"):
        checks.channel_correlations(states, BENCH)
