# SPDX-License-Identifier: Apache-2.0
"""Effects on the piston's motion: dry and viscous friction, a constant force, a cushion, the moving mass.

Viscous friction may differ between the directions, as seals and lead screws have it.
"""

from __future__ import annotations

from dataclasses import replace
from math import isnan

import numpy as np

from hydro_diagnosis.effects.base import MOTION, Effect, FitParameter, FloatArray, Kinematics, Values, changed
from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench

STROKE = 0.08
"""Stroke [m] of a cushion that is not yet adapted to a bench."""
SLIP_VELOCITY = 3e-4
"""Velocity [m/s] over which dry friction changes sign: twice the noise of a velocity from a 1 um encoder."""
STRONGEST = 5e3
"""Largest force [N] of a claim, which a simulation takes."""
HEAVIEST = 1e6
"""Largest damping [N s/m], the same."""


def _force(name: str, *, low: float = 0.0, probes: tuple[float, ...] = (10.0,), smallest: float = 0.3) -> FitParameter:
    return FitParameter(name=name, unit="N", low=low, high=STRONGEST, probes=probes, smallest=smallest)


def down_to_nothing(of_bench: float, otherwise: float) -> float:
    """Return the lowest change that leaves the bench's value above zero."""
    return -otherwise if isnan(of_bench) else -of_bench


class _Motion(Effect):
    family = "friction"
    equations = ("motion",)
    blocks = frozenset({MOTION})


class FrictionCoulomb(_Motion):
    """Level F_c of dry friction; F = F_c sign(x_p')."""

    id = "friction_coulomb"
    says = "Dry friction of {force:.3g} N works against the motion at every speed."
    parameters = (_force("force"),)

    def drag(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        return level + values["force"]


class FrictionCoulombDirectional(_Motion):
    """Level F_c+ while extending, F_c- while retracting."""

    id = "friction_coulomb"
    says = (
        "Dry friction works against the motion: {force_positive:.3g} N while extending, {force_negative:.3g} N "
        "while retracting."
    )
    parameters = (_force("force_positive"), _force("force_negative", probes=(6.0,)))

    def drag(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        return level + np.where(motion.velocity > 0.0, values["force_positive"], values["force_negative"])


class FrictionViscous(_Motion):
    """b + db instead of b."""

    id = "friction_viscous"
    says = "The viscous friction is {size:.3g} N s/m {more} than the bench file says."
    refers = "viscous_friction"

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        low = down_to_nothing(self.reference, HEAVIEST)
        return (FitParameter(name="coefficient", unit="N s/m", low=low, high=HEAVIEST, probes=(30.0,), smallest=1.5),)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, viscous_friction=bench.viscous_friction + values["coefficient"])


class FrictionStribeck(_Motion):
    """Level F_s exp(-(v/v_s)^2) on top of other dry friction (Armstrong-Helouvry et al. 1994, eq. 5)."""

    id = "friction_stribeck"
    says = (
        "Near standstill friction rises by {breakaway_force:.3g} N; the rise is gone above about {velocity:.3g} mm/s."
    )
    parameters = (
        _force("breakaway_force", smallest=0.5),
        FitParameter(name="velocity", unit="m/s", low=2e-3, high=0.06, neutral=0.01, probes=(0.006, 0.02)),
    )

    def drag(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        return level + values["breakaway_force"] * np.exp(-np.square(motion.velocity / values["velocity"]))


class _StribeckExponential(FrictionStribeck):
    """Level F_s exp(-|v|/v_s) (Tustin 1947)."""

    def drag(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        return level + values["breakaway_force"] * np.exp(-np.abs(motion.velocity) / values["velocity"])


FrictionStribeck.other_forms = (_StribeckExponential({"form": "exponential"}),)


class FrictionPresliding(_Motion):
    """Bristles of stiffness sigma: dF/dx = sigma (1 - F sign(v)/level), Dahl's model."""

    id = "friction_presliding"
    says = "Before it slides the piston deflects elastically with {stiffness:.3g} N/m."
    needs = ("friction_coulomb",)
    bristles = True
    parameters = (FitParameter(name="stiffness", unit="N/m", low=3e3, high=3e6, neutral=3e6, probes=(3e4, 3e5)),)

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        return force + memory.bristle("presliding", motion.position, values["stiffness"], level)


class ForceOffset(_Motion):
    """m x_p'' = ... + F_0."""

    id = "force_offset"
    says = "A constant force of {force:.3g} N acts on the moving mass (for instance its weight on a slope)."
    parameters = (_force("force", low=-STRONGEST, smallest=0.5),)

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        return force - values["force"]


class EndCushion(_Motion):
    """F = k max(x_p - x_c, 0) (form "end") or k min(x_p - x_c, 0) (form "start"); quadratic forms reach k at 5 mm."""

    id = "end_cushion"
    refers = "stroke"
    family = "spring"

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        depth = motion.position - values["position"]
        depth = np.maximum(depth, 0.0) if self.options["form"].startswith("end") else np.minimum(depth, 0.0)
        rise = np.abs(depth) / 5e-3 if self.options["form"].endswith("quadratic") else 1.0
        return force + values["stiffness"] * depth * rise

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        stiffness = FitParameter(name="stiffness", unit="N/m", low=0.0, high=1e7, probes=(1e4,), smallest=200.0)
        # on its own half of the stroke: beyond, it would be an offset and a softer spring over the whole range
        stroke = self.reference
        middle, shares = 0.5 * stroke, (0.575, 0.625, 0.675)
        low, high, at = (middle, stroke, tuple(share * stroke for share in shares))
        if self.options["form"].startswith("start"):
            low, high, at = (0.0, middle, tuple((1.0 - share) * stroke for share in shares))
        return (stiffness, FitParameter(name="position", unit="m", low=low, high=high, neutral=middle, probes=at))

    def sentence(self, values: Values) -> str:
        side = "beyond" if self.options["form"].startswith("end") else "below"
        return (
            f"The piston runs into a cushion of {values['stiffness']:.3g} N/m {side} {values['position'] * 1e3:.4g} mm."
        )


class MovingMass(_Motion):
    """m + dm instead of m."""

    id = "moving_mass"
    says = "The moving mass is {size:.3g} kg {more} than the bench file says."
    refers = "moving_mass"

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        low = 0.95 * down_to_nothing(self.reference, 1e3)
        return (FitParameter(name="mass", unit="kg", low=low, high=1e3, probes=(0.3,), smallest=0.05),)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, moving_mass=bench.moving_mass + values["mass"])


_COEFFICIENT = FitParameter(
    name="coefficient_positive", unit="N s/m", low=-HEAVIEST, high=HEAVIEST, probes=(30.0,), smallest=1.5
)


class FrictionViscousDirectional(_Motion):
    """b + db_+ while extending, b + db_- while retracting."""

    id = "friction_viscous"
    says = (
        "The viscous friction depends on the direction: against the bench file {coefficient_positive:+.4g} N s/m while "
        "extending and {coefficient_negative:+.4g} N s/m while retracting."
    )
    refers = "viscous_friction"

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        low = down_to_nothing(self.reference, -_COEFFICIENT.low)
        other = -15.0 if low < -30.0 else 15.0
        extending = replace(_COEFFICIENT, low=low)
        return (extending, replace(extending, name="coefficient_negative", probes=(other,)))

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        extending = motion.velocity > 0.0
        coefficient = np.where(extending, values["coefficient_positive"], values["coefficient_negative"])
        return force + coefficient * motion.velocity


EFFECTS: tuple[Effect, ...] = (
    FrictionCoulomb(),
    FrictionCoulombDirectional({"form": "directional"}),
    FrictionViscous(),
    FrictionStribeck(),
    FrictionPresliding(),
    ForceOffset(),
    *(EndCushion({"form": form}, STROKE) for form in ("end", "start", "end-quadratic", "start-quadratic")),
    MovingMass(),
    FrictionViscousDirectional({"form": "directional"}),
)
