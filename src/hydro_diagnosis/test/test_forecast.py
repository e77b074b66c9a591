# SPDX-License-Identifier: Apache-2.0
"""The closed loop of a recording, simulated with the bench file and with what was found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.ros.messages import LAW_STATE_CODEC
from hydro_core.signals import Law, ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.forecast import LAW_STATE_TOPIC, MAX_FORECAST_ERROR, forecasts, recorded_loop
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.segments import claim, problem_in, record, segment

NOMINAL = Bench.nominal()
CAUSES = [claim("friction_coulomb", 10.0), claim("valve_lag", 120.0, 0.8)]
TRUTH = replace(NOMINAL, effects=tuple(one.to_mapping() for one in CAUSES))


@pytest.fixture(scope="module")
def held() -> StateArray:
    return record(TRUTH, 23, seconds=12.0, waveform=Waveform.SINE)


@pytest.fixture(scope="module")
def worn() -> Problem:
    return problem_in(record(TRUTH, 20, seconds=6.0))


def test_corrected_simulation_says_what_the_bench_gave(worn: Problem, held: StateArray) -> None:
    (found,), why = forecasts(worn, CAUSES, [segment(held)], [])
    assert not why
    assert found.rmse_corrected == pytest.approx(found.rmse_recorded, rel=0.03) and not found.misses
    assert found.rmse_bench_file < 0.7 * found.rmse_recorded
    assert set(found.without) == {"friction_coulomb", "valve_lag"}
    assert all(rmse < 0.95 * found.rmse_corrected for rmse in found.without.values())
    assert "your simulation promised" in found.sentence and "MISSES" not in found.sentence
    (late,), _ = forecasts(worn, CAUSES, [segment(held).cut(3500, 12000)], [])
    assert late.rmse_corrected == pytest.approx(late.rmse_recorded, rel=0.03)


def test_forecast_that_misses_says_so(worn: Problem, held: StateArray) -> None:
    (found,), _ = forecasts(worn, CAUSES[:1], [segment(held)], [])
    assert abs(found.rmse_corrected / found.rmse_recorded - 1.0) > MAX_FORECAST_ERROR
    assert found.misses and "MISSES" in found.sentence
    assert found.without == {"friction_coulomb": found.rmse_bench_file}


def test_loop_of_an_unknown_law_is_not_forecast(held: StateArray) -> None:
    other = segment(held)
    channels = {**other.channels, "nominal_valve_current": 1.2 * other.channels["nominal_valve_current"]}
    with pytest.raises(ValueError, match=r"misses the recorded nominal current by 1\d %"):
        recorded_loop(replace(other, channels=channels), NOMINAL)
    bare = {name: values for name, values in other.channels.items() if name != "reference_force"}
    with pytest.raises(ValueError, match=r"no force law or reference is recorded \(reference_force\)"):
        recorded_loop(replace(other, channels=bare), NOMINAL)


def looped(truth: Bench, waveform: Waveform, kp: float, **more: Any) -> StateArray:
    reference = ReferenceSignal(waveform=waveform, amplitude=220.0, frequency=0.7)
    schedule = Schedule(reference=reference, gains=(kp, 10.0), seconds=8.0, **more)
    return simulate(AnalyticPlant(truth), NOMINAL, schedule, seed=4)


def test_filter_s_corrections_are_played_again(worn: Problem) -> None:
    states = looped(NOMINAL, Waveform.SINE, 60.0, correction=2e-3 * np.sin(np.arange(8000) * 2e-3 * np.pi))
    (found,), _ = forecasts(worn, [], [segment(states)], [])
    assert found.rmse_bench_file == found.rmse_corrected == pytest.approx(found.rmse_recorded, rel=0.03)


def test_compensated_law_is_that_of_the_recording(worn: Problem, tmp_path: Path) -> None:
    """Its f_c stands in the recording of the law's state alone: as the paper's law it is not the recorded one."""
    states = looped(TRUTH, Waveform.MULTISINE, 300.0, law=Law.COMPENSATED)
    with pytest.raises(ValueError, match="the paper law"):
        recorded_loop(segment(states, "bag"), NOMINAL)
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_states(states)
        bag.add_topic(LAW_STATE_TOPIC, "hydro_msgs/msg/LawState")
        for row in states:
            stamp = round(row["time"] * 1e9)
            told = (row["reference_force"], row["reference_force_rate"], 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
            bag.write(
                LAW_STATE_TOPIC, LAW_STATE_CODEC.pack(stamp, int(row["sequence"]), int(Law.COMPENSATED), *told), stamp
            )
    (found,), why = forecasts(worn, CAUSES, [segment(states, "bag")], [tmp_path / "bag"])
    assert found.law == "compensated" and not why
    assert found.rmse_corrected == pytest.approx(found.rmse_recorded, rel=0.03)
