# SPDX-License-Identifier: Apache-2.0
"""Simulated runs as the diagnosis reads them, and how far its windows and residuals are from one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from hydro_core.signals import PLANT_FIELDS, STATE_FIELDS, FloatArray, ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.effects import CANDIDATES, EffectHypothesis
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import WindowSimulation
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import MEASURED_CHANNELS, Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK_STATE_COUNT
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BEGINS, LENGTH = np.arange(300, 1100, 100), 40
"""Samples from which a run is simulated again, and for how many."""


def record(
    truth: Bench,
    seed: int = 1,
    seconds: float = 10.0,
    waveform: Waveform = Waveform.MULTISINE,
    amplitude: float = 260.0,
    *,
    noise: float = 1.0,
    believed: Bench | None = None,
    **more: float,
) -> StateArray:
    """A run of the analytic plant, which shares no code with the diagnosis; the box believes the nominal bench."""
    reference = ReferenceSignal(waveform=waveform, amplitude=amplitude, **{"frequency": 0.7, **more})
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=seconds)
    return simulate(AnalyticPlant(truth, noise=noise), believed or Bench.nominal(), schedule, seed=seed)


def frame(states: StateArray) -> pd.DataFrame:
    """A run as a table: the time and all fields."""
    return pd.DataFrame({"time": states["time"], **{field: states[field] for field in STATE_FIELDS}})


def problem_in(*runs: StateArray, **options: Any) -> Problem:
    """What recordings of a bench that is believed to be the nominal one ask."""
    return Problem([segment(run) for run in runs], Bench.nominal(), **options)


def problem_of(**values: Any) -> Problem:
    """The same of two recordings of the nominal bench with other values."""
    truth = replace(Bench.nominal(), **values)
    return problem_in(record(truth, 3), record(truth, 4, waveform=Waveform.SINE))


def claim(label: str, *sizes: float) -> EffectHypothesis:
    """A cause of the nominal bench; its parameters in turn, those that are not given at their first guesses."""
    effect = next(one for one in CANDIDATES if one.label == label).adapted(Bench.nominal())
    assert len(sizes) <= len(effect.parameters)
    given = dict(zip((one.name for one in effect.parameters), sizes, strict=False))
    return EffectHypothesis(effect, {one.name: one.start_values[0] for one in effect.parameters} | given)


def segment(states: StateArray, name: str = "run") -> Segment:
    """All fields of the nominal bench's run."""
    columns = {field: states[field].copy() for field in STATE_FIELDS}
    return check_recording(RawTable(name, states["time"].copy(), None, columns), Bench.nominal()).segments[0]


def driven(bench: Bench, amplitude: float = 280.0) -> tuple[Segment, FloatArray]:
    """A closed-loop run without noise as a recording, and its physical states, shape (n, 6).

    The box believes the bench's true parameters, so that the paper's law is stable.
    """
    believed = bench.without_effects()
    run = record(bench, 1, 1.2, Waveform.SINE, amplitude, noise=0.0, believed=believed, frequency=0.9)
    current = run["valve_current"].copy()
    plant = AnalyticPlant(bench, noise=0.0)
    shown, states = [plant.measurement()], [plant.state["y"][0, :TEXTBOOK_STATE_COUNT].copy()]
    for held in current[:-1]:
        shown.append(plant.step(float(held)))
        states.append(plant.state["y"][0, :TEXTBOOK_STATE_COUNT].copy())
    columns = dict(zip(PLANT_FIELDS, np.array(shown).T, strict=True))
    channels = {name: np.ascontiguousarray(columns[name]) for name in MEASURED_CHANNELS}
    return Segment("run", 0.0, 1e-3, {**channels, "valve_current": current}), np.array(states)


def apart(segment: Segment, states: FloatArray, claims: Sequence[EffectHypothesis]) -> dict[str, float]:
    """RMS over range of the windows that the same current drives from the same physical states, by channel."""
    simulation = WindowSimulation(SegmentModel(segment, Bench.nominal()), claims)
    readings = simulation.readings(states[BEGINS][:, [2, 3, 0, 1]].T, BEGINS, LENGTH)
    at = BEGINS[None, :] + np.arange(LENGTH)[:, None]
    return {
        name: float(np.sqrt(np.mean((readings[name] - signal[at]) ** 2)) / np.ptp(signal))
        for name, signal in segment.channels.items()
        if name in MEASURED_CHANNELS
    }


def left_by(segment: Segment, claims: Sequence[EffectHypothesis]) -> float:
    """Norm of a noiseless run's residuals under claims, over that without the last; weighted as under the claims."""
    problem = Problem([segment], Bench.nominal()).reweighted(claims)
    return float(np.linalg.norm(problem.residual(claims)) / np.linalg.norm(problem.residual(claims[:-1])))
