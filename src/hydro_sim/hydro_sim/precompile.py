# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable

from hydro_core.signals import ReferenceSignal, Waveform
from hydro_sim import excitation
from hydro_sim.box.firmware import STRUCTURES
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.files import learned_bench, recordings
from hydro_sim.identification import bench_learning
from hydro_sim.identification.validate import AnalyticModel, BenchPrediction, ScoredRun, prediction_errors
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

_RUN_TIME = 8.0
"""Length [s] of the training recording: the shortest that leaves validation data."""


def _simulation() -> None:
    """Simulate a run on both benches, as `collect`, diagnosis and the filter's training do."""
    bench = Bench.nominal()
    for plant in (AnalyticPlant(bench), learned_bench.make_plant()):
        simulate(plant, bench, Schedule(reference=ReferenceSignal(), gains=(60.0, 10.0), seconds=0.1))
        plant.step(0.0)


def _learning() -> None:
    reference = ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=260.0, frequency=0.7)
    run = Schedule(reference=reference, gains=(60.0, 10.0), seconds=_RUN_TIME)
    data = recordings.split({"recording": simulate(AnalyticPlant(Bench.nominal()), Bench.nominal(), run)})
    found = bench_learning.learn(Bench.nominal(), data, count=4)
    scored = [ScoredRun(run=run, truth=None) for run in data.training]
    for predictor in (BenchPrediction(found.bench, data.training), AnalyticModel(Bench.nominal())):
        states = [predictor.estimate(item.run) for item in scored]
        prediction_errors(predictor, states, scored, recorded=True, horizon=70, stride=500)


def _emulator() -> None:
    machine = Machine(profile("default"))
    machine.warm_up()
    machine.plant.step(0.0)


def _emulator_offline() -> None:
    for precision in STRUCTURES:
        Machine(profile("default"), precision=precision).warm_up()
    record_offline(profile("default"), excitation.draw_schedule(0.1, 0))


STEPS: dict[str, Callable[[], None]] = {
    "simulation": _simulation,
    "learning": _learning,
    "emulator": _emulator,
    "emulator, offline and in single precision": _emulator_offline,
}
"""Compilation steps by the message shown while each runs."""
