# SPDX-License-Identifier: Apache-2.0
"""The kernels of each package, compiled by calls on small real inputs: `python -m setup.kernels SCOPE STAMP MACHINE`.

`make setup` runs this in the environment. SCOPE is `all` or `main-job`; STAMP gets MACHINE and the sources as they are.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path

import numpy as np

from hydro_core.signals import SAMPLES_PER_STEP, ReferenceSignal
from hydro_diagnosis.effects import LIBRARY, base, closure, dynamics, memory
from hydro_diagnosis.model import segment_model, simulation
from hydro_diagnosis.recording import MEASURED_CHANNELS, Segment
from hydro_filter.controller import factory, loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.envs import FILTERS, vector_env
from hydro_policy.sac.sac import compile_update
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_sim import excitation
from hydro_sim.box.firmware import STRUCTURES
from hydro_sim.emulator import offline
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.config import profile
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.tables import KNOTS
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()


def _filters() -> None:
    factory.FilterChoice(bench=BENCH).make(loop_filter.LoopFilterSettings())
    loop_filter.loop_filter(ScheduledMetric.load(), BENCH, BENCH)


def _learner() -> None:
    if sentence := compile_update(OBSERVATION_SIZE, ACTION_SIZE, SacSettings().hidden_size):
        print(sentence, flush=True)


def _estimator() -> None:
    samples = np.zeros((1, SAMPLES_PER_STEP))
    Compensator().step(samples, samples, np.ones(1, bool), samples)


def _vector_benches() -> None:
    for plant, kind in product((AnalyticPlant(BENCH), learned_bench.make_plant()), FILTERS):
        benches = vector_env.VectorBench([BENCH], [plant], filters=vector_env.vector_filter(kind, BENCH, 1))
        benches.reset(0, ReferenceSignal(), 0)
        benches.step(np.zeros((1, ACTION_SIZE)))


def _emulator() -> None:
    machine = Machine(profile("default"))
    machine.warm_up()
    machine.plant.step(0.0)


def _emulator_offline() -> None:
    for precision in STRUCTURES:
        Machine(profile("default"), precision=precision).warm_up()
    offline.record_offline(profile("default"), excitation.draw_schedule(0.1, 0))


def _simulation() -> None:
    for plant in (AnalyticPlant(BENCH), learned_bench.make_plant()):
        simulate(plant, BENCH, Schedule(reference=ReferenceSignal(), gains=(60.0, 10.0), seconds=0.1))
        plant.step(0.0)


def _diagnosis() -> None:
    path, record = np.zeros(10), memory.Memory(1e-3)
    record.bristle(path, 2e5, np.ones(10))
    record.play(path, 0.1)
    record.volume_pressure((path, path, path, path), 1e-13)
    dynamics.overlap_output(np.zeros((10, 4)), 1e-3, 1e-4)
    closure.evaluate_spline(path, 0.0, 1.0, np.zeros(KNOTS))
    rest = {name: np.full(200, 1e6 if name.startswith("pressure") else 0.0) for name in MEASURED_CHANNELS}
    model = segment_model.SegmentModel(Segment("rest", 0.0, 1e-3, {**rest, "valve_current": np.zeros(200)}), BENCH)
    causes = {effect.label: effect for effect in LIBRARY}
    leak = base.EffectHypothesis(causes["leakage_internal"], {"coefficient": 0.0})
    gain = base.EffectHypothesis(causes["valve_gain"], {"ratio": 1.0})
    line = base.EffectHypothesis(causes["return_line"], {"resistance": 0.0, "time_constant": 0.05})
    for claims in ((), (leak,), (gain,), (line,)):
        model.residuals(base.PRESSURE, claims), model.motion_residual(claims)
        simulated, begins = simulation.WindowSimulation(model, claims), np.arange(20, 40, 10)
        simulated.readings(simulated.recorded[:, begins], begins, 3)


MAIN_JOB: dict[str, Callable[[], None]] = {
    "learner": _learner, "estimator": _estimator, "emulator": _emulator, "filter": _filters,
}  # fmt: skip
"""What `make train` runs, the longest first."""
KERNELS = MAIN_JOB | {
    "vector benches": _vector_benches, "offline emulator": _emulator_offline,
    "simulation": _simulation, "diagnosis": _diagnosis,
}  # fmt: skip


def main(scope: str, stamp: Path, machine: str) -> None:
    """Compile, in a process per core, and write down of which sources."""
    kernels = MAIN_JOB if scope == "main-job" else KERNELS
    loaded = [str(Path(file).resolve()) for module in sys.modules.values() if (file := getattr(module, "__file__", ""))]
    sources = {file: [(stat := os.stat(file)).st_mtime_ns, stat.st_size] for file in loaded if "/src/hydro_" in file}
    context = multiprocessing.get_context("fork")  # the packages are imported once
    with ProcessPoolExecutor(min(4, len(os.sched_getaffinity(0))), context) as pool:  # each takes half a gigabyte
        futures = {pool.submit(call): name for name, call in kernels.items()}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                future.result()
                print(f"{done} of {len(futures)}: {futures[future]}", flush=True)
        finally:  # after a failure what has begun would be waited for, and what has not, be done
            for child in multiprocessing.active_children():
                child.kill()
    stamp.write_text(json.dumps({"machine": machine, "sources": sources}))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3])
