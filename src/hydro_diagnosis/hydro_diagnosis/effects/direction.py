# SPDX-License-Identifier: Apache-2.0
"""Viscous friction that differs between the directions, as seals and lead screws have it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import MOTION, Effect, FitParameter, FloatArray, Kinematics, Memory, Values
from hydro_diagnosis.effects.friction import down_to_nothing
from hydro_sim.model.bench import Bench

_COEFFICIENT = FitParameter(
    name="coefficient_positive", unit="N s/m", low=-1e4, high=1e4, neutral=0.0, probes=(30.0,), smallest=1.5
)


class FrictionViscousDirectional(Effect):
    """b + db_+ while extending, b + db_- while retracting."""

    id = "friction_viscous"
    family = "friction"
    equations = ("motion",)
    touches = frozenset({MOTION})

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        low = down_to_nothing(self.reference, -_COEFFICIENT.low)
        other = -15.0 if low < -30.0 else 15.0
        extending = replace(_COEFFICIENT, low=low)
        return (extending, replace(extending, name="coefficient_negative", probes=(other,)))

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, reference=bench.viscous_friction)

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        extending = motion.velocity > 0.0
        coefficient = np.where(extending, values["coefficient_positive"], values["coefficient_negative"])
        return force + coefficient * motion.velocity

    def sentence(self, values: Values) -> str:
        positive, negative = values["coefficient_positive"], values["coefficient_negative"]
        return (
            f"The viscous friction depends on the direction: against the bench file {positive:+.4g} N s/m while "
            f"extending and {negative:+.4g} N s/m while retracting."
        )


EFFECTS: tuple[Effect, ...] = (FrictionViscousDirectional({"form": "directional"}),)
