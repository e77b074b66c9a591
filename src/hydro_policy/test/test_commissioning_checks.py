# SPDX-License-Identifier: Apache-2.0
"""What the gates of a commissioning read off recordings: a right bench passes, each mistake has its sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import Flag, ReferenceSignal, StateArray, Waveform
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


REST, MOVING = recorded(0.0), recorded(60.0)
MOTION = MOVING[1000:]


def altered(states: StateArray, **channels: object) -> StateArray:
    made = states.copy()
    for name, values in channels.items():
        made[name] = values
    return made


def test_a_right_bench_passes_and_one_that_drifts_is_warned_of() -> None:
    noise, off = checks.sensor_noise(REST, BENCH)
    assert noise["load_force"] == pytest.approx(0.6, rel=0.1) and abs(off) < 1.0
    assert min(checks.channel_correlations(MOTION, BENCH).values()) > checks.CORRELATION_MIN
    force, time = REST["load_force"], REST["time"]
    creeping = altered(REST, load_force=force + 0.4 * time)
    assert checks.drift_rate(creeping) - checks.drift_rate(REST) == pytest.approx(0.4)
    assert checks.drift_warning(creeping, 300.0) == ""
    warning = checks.drift_warning(altered(REST, load_force=force + 6.4 * time), 300.0)
    assert "crept by 6.4 N/s: null the valve" in warning
    assert "stood at 800 N" in checks.drift_warning(altered(REST, load_force=800.0 + force), 300.0)


@pytest.mark.parametrize(
    ("check", "right", "wrong", "sentence"),
    [
        (checks.sensor_noise, REST, {"pressure_a": "pressure_b", "pressure_b": "pressure_a"}, "differs from the press"),
        (checks.sensor_noise, REST, {"pressure_a": 1e-5}, "differs from the pressures"),
        (checks.sensor_noise, REST, {"load_force": 0.0}, "is stuck"),
        (checks.channel_correlations, MOTION, {"load_force": -1.0}, "load force and its reference"),
        (checks.channel_correlations, MOTION, {"piston_velocity": -1.0}, "velocity and position"),
    ],
)
def test_a_reading_at_rest_that_cannot_be_and_a_sign_are_told(
    check: Callable[[StateArray, Bench], object], right: StateArray, wrong: dict[str, str | float], sentence: str
) -> None:
    """Channels are exchanged, or scaled."""
    values = {name: right[other] if isinstance(other, str) else other * right[name] for name, other in wrong.items()}
    with pytest.raises(GateError, match=sentence):
        check(altered(right, **values), BENCH)


def test_a_force_that_an_overlap_holds_back_still_follows_and_a_valve_that_hangs_is_told() -> None:
    late = np.roll(MOTION["reference_force"], 300)
    checks.require_tracking(altered(MOTION, load_force=0.6 * late), 0.5)
    with pytest.raises(GateError, match="times the swing"):
        checks.require_tracking(altered(MOTION, load_force=0.06 * late), 0.5)


def test_lost_samples_and_late_commands_count() -> None:
    states = altered(MOVING[:1000], flags=Flag.ARMED)
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
    checks.require_matching_filter(MOVING, default_filter(BENCH))
    with pytest.raises(GateError, match="spring or its load cell"):
        checks.require_matching_filter(altered(MOVING, load_force=1.3 * MOVING["load_force"]), default_filter(BENCH))


def test_a_piston_that_stands_is_no_exchanged_channel_and_is_moved_further() -> None:
    states = altered(MOTION, piston_position=0.05, load_force=0.0)
    assert checks.is_motion_blocked(states)
    with pytest.raises(GateError, match="the piston did not move under currents up to"):
        checks.channel_correlations(states, BENCH)
