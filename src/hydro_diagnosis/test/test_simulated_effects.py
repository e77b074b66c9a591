# SPDX-License-Identifier: Apache-2.0
"""The simulation's effects (`model.effects`) and the diagnosis' forward simulation, written apart, say the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import PLANT_FIELDS, ReferenceSignal, Waveform
from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.recording import MEASURED, Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK
from hydro_sim.model.effects.catalogue import CATALOGUE, label
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
EFFECTS = [effect.adapted(BENCH) for effect in LIBRARY]
BEGINS = np.arange(300, 1100, 100)
LENGTH = 40
TOLERANCE = 2e-4
"""RMS of the difference after up to 40 ms, over the signal's range."""


def claims_with(effect: Effect) -> list[Claim]:
    """The effect at its first guess, after what it needs."""
    needed = [next(one for one in EFFECTS if one.id == name) for name in effect.needs]
    return [Claim(one, {entry.name: entry.probes[0] for entry in one.parameters}) for one in (*needed, effect)]


def driven(bench: Bench) -> tuple[Segment, FloatArray]:
    """A closed-loop run without noise as a recording, and its physical states, shape (n, 6)."""
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=280.0, frequency=0.9)
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=1.2)
    current = simulate(AnalyticPlant(bench, noise=0.0), BENCH, schedule)["valve_current"].copy()
    plant = AnalyticPlant(bench, noise=0.0)
    shown, states = [plant.measurement()], [plant.state["y"][0, :TEXTBOOK].copy()]
    for held in current[:-1]:
        shown.append(plant.step(float(held)))
        states.append(plant.state["y"][0, :TEXTBOOK].copy())
    columns = dict(zip(PLANT_FIELDS, np.array(shown).T, strict=True))
    channels = {name: np.ascontiguousarray(columns[name]) for name in MEASURED}
    return Segment("run", 0.0, 1e-3, {**channels, "valve_current": current}), np.array(states)


def apart(segment: Segment, states: FloatArray, claims: Sequence[Claim]) -> dict[str, float]:
    """Of the diagnosis' forward simulation under the same current from the same states, by channel."""
    plant = Plant.of(SegmentModel(segment, BENCH), claims)
    readings = plant.measurements(plant.run(states[BEGINS][:, [2, 3, 0, 1]].T.copy(), BEGINS, LENGTH), BEGINS)
    at = BEGINS[None, :] + np.arange(LENGTH)[:, None]
    return {
        name: float(np.sqrt(np.mean((readings[name] - signal[at]) ** 2)) / np.ptp(signal))
        for name, signal in segment.channels.items()
        if name in MEASURED
    }


def test_every_value_that_a_diagnosis_may_report_is_simulated() -> None:
    for effect in EFFECTS:
        entry = Claim(effect, {one.name: one.probes[0] for one in effect.parameters}).to_mapping()
        simulated = {quantity.name: quantity for quantity in CATALOGUE[label(entry)].parameters}
        for one in effect.parameters:
            assert simulated[one.name].low <= one.low and one.high <= simulated[one.name].high, effect.label


@pytest.mark.proves("diagnosed")
@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.label)
def test_simulation_and_diagnosis_mean_the_same_effect(effect: Effect) -> None:
    claims = claims_with(effect)
    segment, states = driven(replace(BENCH, effects=tuple(claim.to_mapping() for claim in claims)))
    with_it, without = apart(segment, states, claims), apart(segment, states, claims[:-1])
    if effect.label == "backlash:play":  # the diagnosis takes its readings from the middle of the gap in each window
        assert with_it.pop("load_force") < 0.5 * without.pop("load_force")
    assert max(with_it.values()) < TOLERANCE
    assert max(without[name] / with_it[name] for name in with_it) > 20.0
