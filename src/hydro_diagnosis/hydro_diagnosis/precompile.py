# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.effects.base import PRESSURE, EffectHypothesis
from hydro_diagnosis.effects.closure import evaluate_spline
from hydro_diagnosis.effects.dynamics import overlap_output
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.recording import MEASURED_CHANNELS, Segment
from hydro_sim.model.bench import Bench
from hydro_sim.model.tables import KNOTS


def _memory() -> None:
    path, record = np.zeros(10), Memory(1e-3)
    record.bristle("z", path, 2e5, np.ones(10))
    record.play("p", path, 0.1)
    overlap_output(np.zeros((10, 4)), 1e-3, 1e-4)
    evaluate_spline(path, 0.0, 1.0, np.zeros(KNOTS))


def _equations() -> None:
    """Residuals and simulation of a bench at rest, with and without effects in its chambers."""
    rest = {name: np.full(200, 1e6 if name.startswith("pressure") else 0.0) for name in MEASURED_CHANNELS}
    model = SegmentModel(Segment("rest", 0.0, 1e-3, {**rest, "valve_current": np.zeros(200)}), Bench.nominal())
    begins = np.arange(20, 40, 10)
    causes = {effect.label: effect for effect in LIBRARY}
    leak, gain = (
        EffectHypothesis(causes["leakage_internal"], {"coefficient": 0.0}),
        EffectHypothesis(causes["valve_gain"], {"ratio": 1.0}),
    )
    for claims in ((), (leak,), (gain,)):
        model.residuals(PRESSURE, claims), model.motion_residual(claims)
        plant = Plant.of(model, claims)
        plant.run(plant.start(begins), begins, 3)


STEPS: dict[str, Callable[[], None]] = {"diagnosis": _memory, "chamber equations of the diagnosis": _equations}
"""Compilation steps by progress text. `hydro_sim`, whose functions simulate recordings, has steps of its own."""
