# SPDX-License-Identifier: Apache-2.0
"""Synthetic recordings of the assumed bench, to rehearse a recording before it is proposed and to calibrate on.

The plant is `hydro_sim.model.plant.AnalyticPlant` with the box's own force law; it knows nothing of the effects.
"""

from __future__ import annotations

from dataclasses import replace

from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.recording import Recording
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate


def rehearsal(
    bench: Bench,
    reference: ReferenceSignal,
    *,
    gains: tuple[float, float] = (60.0, 10.0),
    seconds: float = 10.0,
    noise: float = 1.0,
    seed: int = 0,
    truth: Bench | None = None,
) -> Recording:
    """One run under the box's force law.

    Parameters
    ----------
    bench
        What the box believes.
    reference, gains, seconds
        What is commanded: K_p [1/s], K_i [1/s^2], length [s].
    noise, seed
        Scale and seed of the sensors' noise.
    truth
        What is simulated, `bench` by default.
    """
    plant = AnalyticPlant(replace(truth or bench, effects=(), closures=()), noise=noise)
    believed = replace(bench, effects=(), closures=())
    states = simulate(plant, believed, Schedule(reference=reference, gains=gains, seconds=seconds), seed=seed)
    columns = {name: states[name].copy() for name in STATE_FIELDS}
    return checked(RawTable("rehearsal", states["time"].copy(), None, columns), believed)
