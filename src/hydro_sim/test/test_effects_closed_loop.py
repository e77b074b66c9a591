# SPDX-License-Identifier: Apache-2.0
"""A loop closed on the analytic plant with an effect tracks as on the truth with that effect, which shares no code."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydro_bridge.signals import ReferenceSignal, StateArray, Waveform
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation.schedules import Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=250.0, frequency=1.0)
CASES: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("transport_delay", {"time": 2e-3}, {}),
    ("valve_lag", {"bandwidth": 60.0, "damping": 0.9}, {}),
    ("valve_deadband", {"half_width": 1e-4}, {}),
    ("valve_gain", {"ratio": 0.85}, {}),
    ("leakage_internal", {"coefficient": 3e-13}, {}),
    ("friction_coulomb", {"force": 15.0}, {}),
    ("supply_droop", {"resistance": 5e10, "time_constant": 0.02}, {}),
    ("entrained_air", {"volume_fraction": 0.02}, {}),
    ("load_cell_gain", {"ratio": 1.1}, {"cell": "load_force"}),
    ("sensor_lag", {"bandwidth": 15.0, "damping": 0.7}, {"sensor": "load_force"}),
    ("spring_hardening", {"coefficient": 2e7}, {}),
    ("backlash", {"width": 1e-3}, {"form": "play"}),
]
"""Id, parameters, options; the words are the same for the emulator and for a corrected.yaml."""


def rmse(states: StateArray) -> float:
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"])[1000:] ** 2)))


@pytest.mark.parametrize(("name", "parameters", "options"), CASES, ids=[case[0] for case in CASES])
def test_tracking_error_is_that_of_the_truth(
    name: str, parameters: dict[str, Any], options: dict[str, Any], bench: Bench
) -> None:
    segment = Segment.of(SINE, 4.0, kp=60.0, ki=10.0)
    truth = truth_from_mapping({"profile": "nominal", "effects": {name: {**parameters, **options}}})
    expected = rmse(record_offline(truth, [segment], seed=3).states)
    schedule = Schedule(reference=SINE, gains=(60.0, 10.0), seconds=4.0)
    corrected = replace(bench, effects=({"id": name, **options, "parameters": parameters},))
    simulated = rmse(simulate(AnalyticPlant(corrected), bench, schedule))
    left_out = rmse(simulate(AnalyticPlant(bench), bench, schedule))
    with_it, without = simulated / expected - 1.0, left_out / expected - 1.0
    print(f"{name}: truth {expected:.2f} N, with it {with_it:+.2%}, without {without:+.2%}")
    assert simulated == pytest.approx(expected, rel=0.01)
    if abs(without) > 0.05:
        assert abs(with_it) < 0.1 * abs(without)
