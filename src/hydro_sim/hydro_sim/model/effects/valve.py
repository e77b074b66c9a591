# SPDX-License-Identifier: Apache-2.0
"""From the valve current to the four edges: dead time, spool, overlap, gain, wear.

A step sees the spool's mean over the step: currents are held for a sample, so dead times and linear lags are exact on
average. Sources: Merritt 1967, sections 5-3 to 5-6; the diagnosis' `effects.valve`, `.valve_dynamics`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_sim.model.effects import lags
from hydro_sim.model.effects.base import Effect, hidden, parameter
from hydro_sim.model.equations import Symbol, clip

DRIFT_LOW, DRIFT_HIGH = 0.2, 5.0
"""Bounds of a gain that drifts with time: a simulation may run for hours."""


class TransportDelay(Effect):
    """Pure dead time on the command; the model keeps the past currents (`model.assembly`)."""

    id = "transport_delay"
    time = parameter("s", 0.0, 0.03, scale=2e-3)


class ValveOffset(Effect):
    """Null shift."""

    id = "valve_offset"
    current = parameter("A", -0.1, 0.1, scale=5e-4)

    def command(self, spool: Symbol) -> Symbol:
        return spool + self.current


class ValveLag(Effect):
    """Spool of second order, exact for a held current."""

    id = "valve_lag"
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0)
    damping = parameter("-", 0.1, 5.0, scale=0.5, neutral=1.0)
    spool = hidden("A", scale=1e-3)
    rate = hidden("A/s", scale=0.1)

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"spool": signals["spool"]}

    def command(self, spool: Symbol) -> Symbol:
        moved, mean = lags.step_constant_input(self.at, self.bandwidth, self.damping, (self.spool, self.rate), spool)
        self.next["spool"], self.next["rate"] = moved
        return mean

    def flow(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        state = self.spool, self.rate
        return self.spool, {"spool": self.rate, **lags.lag_rates(self.bandwidth, self.damping, state, signal)}


class ValveLagFirstOrder(Effect):
    """Spool of first order, exact for a held current."""

    id = "valve_lag"
    options = {"form": ("first_order",)}
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0)
    spool = hidden("A", scale=1e-3)

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"spool": signals["spool"]}

    def command(self, spool: Symbol) -> Symbol:
        reach = self.at.once(2.0 * np.pi * self.bandwidth * self.at.step)
        left = self.at.once(np.exp(-reach))
        self.next["spool"] = spool + (self.spool - spool) * left
        return spool + (self.spool - spool) * self.at.once((1.0 - left) / reach)

    def flow(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        return self.spool, {"spool": 2.0 * np.pi * self.bandwidth * (signal - self.spool)}


class ValveDeadband(Effect):
    """Overlap, the same on both sides: nothing flows while the spool is within it."""

    id = "valve_deadband"
    late = True
    half_width = parameter("A", 0.0, 0.1, scale=5e-4)

    def command(self, spool: Symbol) -> Symbol:
        return spool - clip(spool, -self.half_width, self.half_width)


class ValveDeadbandLopsided(ValveDeadband):
    """Overlap, another on each side."""

    options = {"form": ("lopsided",)}
    half_width_negative = parameter("A", 0.0, 0.1, scale=5e-4)

    def command(self, spool: Symbol) -> Symbol:
        return spool - clip(spool, -self.half_width_negative, self.half_width)


class ValveDeadbandSoft(ValveDeadband):
    """Overlap whose edges open gradually: each side is a softplus of what exceeds the half width."""

    options = {"form": ("soft",)}
    softness = parameter("A", 1e-7, 0.1, scale=1e-4, neutral=1e-7)

    def command(self, spool: Symbol) -> Symbol:
        beyond, below = spool - self.half_width, -spool - self.half_width
        return self.softness * (_softplus(beyond / self.softness) - _softplus(below / self.softness))


class ValveGain(Effect):
    """Wrong K_v in the bench file."""

    id = "valve_gain"
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        return out * self.ratio, back * self.ratio


class ValveGainAsymmetry(Effect):
    """Another K_v where the piston is driven back."""

    id = "valve_gain_asymmetry"
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        return out, back * self.ratio


class ValveGainDrift(Effect):
    """K_v changes with time since reset."""

    id = "valve_gain_drift"
    rate = parameter("1/s", -1.0, 1.0, scale=0.01)
    time = hidden("s", scale=10.0)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        self.next["time"] = self.time + self.at.step
        ratio = clip(1.0 + self.rate * (self.time + 0.5 * self.at.step), DRIFT_LOW, DRIFT_HIGH)
        return out * ratio, back * ratio


class ValveNullLeakage(Effect):
    """Worn edges leak around null, all four."""

    id = "valve_null_leakage"
    options = {"form": ("exponential", "gaussian", "hyperbolic", "lorentzian")}
    all_edges = True
    coefficient = parameter("m3/s/sqrt(Pa)", 0.0, 1e-6, scale=1e-10)
    width = parameter("A", 1e-6, 0.1, scale=1e-3, neutral=1e-3)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        wear = self.coefficient * _profile(self.form, np.abs(spool) / self.width)
        return out + wear, back + wear


def _profile(form: str, ratio: Symbol) -> Symbol:
    """Share of the wear that is left where the spool is `ratio` widths from null."""
    match form:
        case "exponential":
            return np.exp(-ratio)
        case "gaussian":
            return np.exp(-ratio * ratio)
        case "hyperbolic":
            return 1.0 / (1.0 + ratio)
    return 1.0 / (1.0 + ratio * ratio)


def _softplus(ratio: Symbol) -> Symbol:
    return np.fmax(ratio, 0.0) + np.log1p(np.exp(-np.abs(ratio)))


EFFECTS = (
    TransportDelay, ValveOffset, ValveLag, ValveLagFirstOrder, ValveDeadband, ValveDeadbandLopsided, ValveDeadbandSoft,
    ValveGain, ValveGainAsymmetry, ValveGainDrift, ValveNullLeakage,
)  # fmt: skip
