# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_sim.files import recordings
from hydro_sim.identification import adam, evaluation, stages, training
from hydro_sim.identification.analytic import AnalyticModel
from hydro_sim.identification.evaluation import Scored
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant
from hydro_sim.simulation.offline import Schedule, simulate
from hydro_sim.structured.model import StructuredModel

_SECONDS = 8.0
"""Length [s] of the training recording: the shortest that leaves validation data."""


def _simulation() -> None:
    _simulated(AnalyticPlant(Bench.nominal()))
    _simulated(LearnedPlant())


def _simulated(plant: Plant) -> None:
    """Simulate a run with all features of a schedule, as `collect`, diagnosis and the filter's training use them."""
    run = Schedule(reference=ReferenceSignal(), gains=(60.0, 10.0), seconds=0.1)
    bench = Bench.nominal()
    simulate(plant, bench, run)
    simulate(plant, bench, replace(run, correction=np.zeros(run.samples)))
    plant.step(0.0)


def learned(structure: str, hidden: tuple[int, ...] = (32, 32)) -> Learned:
    """Return a model after one epoch on a short recording."""
    data = _data()
    few = training.STRUCTURED_ADAM if structure == "structured" else adam.Settings()
    settings = training.Settings(structure=structure, hidden=hidden, batch=64, stride=500, adam=replace(few, epochs=1))
    model = training.start(data, settings, Bench.nominal())
    if isinstance(model, StructuredModel):
        stages.prediction_rms(model, data)
    *_, (_, trained) = training.steps(model, data, settings)
    return training.finished(trained, data, {})


def _learning(structure: str, hidden: tuple[int, ...] = (32, 32)) -> None:
    """`learn` in small, `validate` of its outcome, and the outcome as a plant."""
    made = learned(structure, hidden)
    _simulated(LearnedPlant(made))
    scored = [Scored(run=run, truth=None) for run in _data().training]
    for predictor in (made.model, AnalyticModel(Bench.nominal())):
        states = [predictor.estimate(item.run) for item in scored]
        evaluation.prediction_errors(predictor, states, scored, recorded=True, horizon=70, stride=500)


@cache
def _data() -> recordings.Data:
    reference = ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=260.0, frequency=0.7)
    run = Schedule(reference=reference, gains=(60.0, 10.0), seconds=_SECONDS)
    return recordings.split({"recording": simulate(AnalyticPlant(Bench.nominal()), Bench.nominal(), run)})


STEPS: dict[str, Callable[[], None]] = {
    "simulation": _simulation,
    "learning, structured": lambda: _learning("structured"),
    "learning, network": lambda: _learning("network"),
    "learning, residual": lambda: _learning("residual"),
    "learning, deep network": lambda: _learning("network", (16, 16, 16)),
}
"""By the message shown while each runs."""
