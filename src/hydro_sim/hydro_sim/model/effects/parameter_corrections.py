# SPDX-License-Identifier: Apache-2.0
"""Corrections of the bench file's parameters, in the order of the file, clipped to the parameters' ranges."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import Any, ClassVar

from hydro_sim.model.effects.base import Effect, FitParameter, fit, parameter
from hydro_sim.model.effects.friction import DAMPING_MAX


class Correction(Effect):
    """Correction of a parameter of the bench file."""

    bench_parameter: str
    """Name of the parameter in bench.yaml."""


class AdditiveCorrection(Correction):
    """Additive correction of a parameter of the bench file; the corrected parameter stays above zero."""

    reduction_max: ClassVar[float] = 1.0
    """Largest share of the file's value that the correction may subtract."""

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        (change,) = super().fitted_parameters(bench)
        filed = getattr(bench, self.bench_parameter)
        return (replace(change, low=self.reduction_max * (-filed if isfinite(filed) else change.low)),)

    def correct(self, n: Any) -> None:
        setattr(n, self.bench_parameter, getattr(n, self.bench_parameter) + getattr(self, self.parameters[0].name))


class ValueCorrection(Correction):
    """Correction by the parameter's true value; the start value of its fit is relative to the file's."""

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        (true,) = super().fitted_parameters(bench)
        filed = getattr(bench, self.bench_parameter)
        return (replace(true, neutral=filed, start_values=(filed + true.start_values[0],)),)

    def correct(self, n: Any) -> None:
        setattr(n, self.bench_parameter, getattr(self, self.parameters[0].name))


class RatioCorrection(Correction):
    """Correction by the ratio of the parameter's true value to the file's."""

    words: str
    """The parameter in words."""
    sentence_template = "The {effect.words} is {ratio:.4g} times what the bench file says."

    def correct(self, n: Any) -> None:
        setattr(n, self.bench_parameter, getattr(n, self.bench_parameter) * self.ratio)


def ratio_parameter(scale: float, *, smallest_reported: float = 0.003, low: float = 0.3, high: float = 3.0) -> Any:
    """Declare the ratio of a parameter's true value to the file's."""
    fitted = fit(0.95, smallest_reported=smallest_reported, low=low, high=high)
    return parameter("-", 0.01, 100.0, scale=scale, neutral=1.0, fit=fitted)


class FrictionViscous(AdditiveCorrection):
    """Correction of the viscous friction: b + db."""

    id, bench_parameter = "friction_viscous", "viscous_friction"
    equations = ("motion",)
    family = "friction"
    sentence_template = "The viscous friction is {size:.3g} N s/m {more} than the bench file says."
    coefficient = parameter("N s/m", -1e9, 1e9, scale=30.0,
                            fit=fit(30.0, smallest_reported=1.5, low=-DAMPING_MAX, high=DAMPING_MAX))  # fmt: skip


class MovingMass(AdditiveCorrection):
    """Correction of the moving mass: m + dm."""

    id, bench_parameter = "moving_mass", "moving_mass"
    equations = ("motion",)
    family = "friction"
    sentence_template = "The moving mass is {size:.3g} kg {more} than the bench file says."
    reduction_max = 0.95
    mass = parameter("kg", -1e7, 1e7, scale=0.3, fit=fit(0.3, smallest_reported=0.05, low=-1e3, high=1e3))


class SpringStiffness(RatioCorrection):
    """Ratio of the spring stiffness k_s to the bench file's."""

    id, bench_parameter = "spring_stiffness", "spring_stiffness"
    equations = ("load",)
    family = "spring"
    sentence_template = "The spring is {ratio:.4g} times as stiff as the bench file says."
    ratio = ratio_parameter(0.1, smallest_reported=0.002, low=0.05, high=20.0)


class SpringRest(ValueCorrection):
    """True rest position of the spring."""

    id, bench_parameter = "spring_rest", "spring_rest_position"
    equations = ("load",)
    family = "spring"
    sentence_template = "The spring rests at {position:.5g} mm, not where the bench file says."
    position = parameter("m", -5.0, 5.0, scale=1e-3, fit=fit(1e-3, smallest_reported=2e-5))


class SupplyPressure(RatioCorrection):
    """Ratio of the supply pressure p_s to the bench file's."""

    id, bench_parameter, words = "supply_pressure", "supply_pressure", "supply pressure"
    equations = ("actuation",)
    ratio = ratio_parameter(0.05)


class TankPressure(ValueCorrection):
    """True tank pressure p_t."""

    id, bench_parameter = "tank_pressure", "tank_pressure"
    equations = ("actuation",)
    sentence_template = "The tank stands at {pressure:.3g} MPa, not at what the bench file says."
    display_factors = {"pressure": 1e-6}
    pressure = parameter("Pa", 0.0, 1e7, scale=1e5, fit=fit(2e5, smallest_reported=1e4, high=5e6))


class PistonArea(RatioCorrection):
    """Ratio of the piston area A_p, and with it of A_b = alpha A_p, to the bench file's."""

    id, bench_parameter, words = "piston_area", "piston_area", "piston area"
    equations = ("pressure_a", "pressure_b")
    balances = frozenset({"pressure", "motion", "hydraulic"})
    ratio = ratio_parameter(0.02)


class AreaRatio(RatioCorrection):
    """Ratio of the area ratio alpha to the bench file's."""

    id, bench_parameter, words = "area_ratio", "area_ratio", "ratio of the piston areas"
    equations = ("pressure_b",)
    balances = PistonArea.balances
    ratio = ratio_parameter(0.02)


class DeadVolume(RatioCorrection):
    """Ratio of a chamber's dead volume V_dead to the bench file's."""

    id = "dead_volume"
    options = {"chamber": ("a", "b")}
    ratio = ratio_parameter(0.1, smallest_reported=0.004, low=0.1, high=10.0)

    def __init__(self, **chosen: str) -> None:
        super().__init__(**chosen)
        self.bench_parameter, self.equations = f"dead_volume_{self.chamber}", (f"pressure_{self.chamber}",)
        self.words = f"dead volume of chamber {self.chamber.upper()}"


EFFECTS = (
    FrictionViscous, MovingMass, SpringStiffness, SpringRest, SupplyPressure, TankPressure, PistonArea, AreaRatio,
    DeadVolume,
)  # fmt: skip
