# SPDX-License-Identifier: Apache-2.0
"""Valve effects from the current to the four edges: dead time, spool, overlap, gain, wear.

A step uses the spool's mean over the step: currents are held for a sample, so dead times and linear lags are exact on
average. Source: Merritt 1967, sections 5-3 to 5-6.
"""

from __future__ import annotations

import numpy as np

from hydro_sim.model.effects import lags
from hydro_sim.model.effects.base import DRIFT_MAX, DRIFT_MIN, Effect, fit, hidden, parameter
from hydro_sim.model.equations import EDGES, Symbol, clip

_PORTS = {"p": "supply", "a": "chamber A", "b": "chamber B", "t": "tank"}

_OVERLAP = fit(1e-4, 5e-4, smallest_reported=5e-6, high=0.02)
_RATIO = fit(0.9, smallest_reported=0.004, low=0.2, high=5.0)
_BANDWIDTH = fit(40.0, 120.0, 250.0, low=8.0, high=600.0, neutral=600.0)


class _Valve(Effect):
    equations = ("actuation",)
    family = "valve"


class TransportDelay(_Valve):
    """Pure dead time on the command; the model keeps the past currents (`model.assembly`)."""

    id = "transport_delay"
    sentence_template = "The valve answers the current {time:.3g} ms late, a pure dead time."
    time = parameter("s", 0.0, 0.03, scale=2e-3, fit=fit(5e-4, 2e-3, 5e-3, smallest_reported=2e-5))


class ValveOffset(_Valve):
    """Null shift: the spool stands at u + u_0."""

    id = "valve_offset"
    sentence_template = "The valve's null is shifted: it acts as if {current:.3g} mA were added to the current."
    current = parameter("A", -10.0, 10.0, scale=5e-4, fit=fit(2e-4, smallest_reported=4e-6, low=-0.02, high=0.02))

    def command(self, spool: Symbol) -> Symbol:
        return spool + self.current


class ValveLag(_Valve):
    """Spool of second order, exact for a held current: s'' + 2 D w s' + w^2 s = w^2 u."""

    id = "valve_lag"
    sentence_template = "The spool follows the current with a lag: bandwidth {bandwidth:.4g} Hz, damping {damping:.3g}."
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0, fit=_BANDWIDTH)
    damping = parameter("-", 0.1, 5.0, scale=0.5, neutral=1.0, fit=fit(0.8, low=0.2, high=3.0, neutral=0.8))
    spool = hidden("A", scale=1e-3, initial_signal="spool")
    rate = hidden("A/s", scale=0.1)

    def command(self, spool: Symbol) -> Symbol:
        moved, mean = lags.step_zero_order_hold(self.at, self.bandwidth, self.damping, (self.spool, self.rate), spool)
        self.next["spool"], self.next["rate"] = moved
        return mean

    def continuous_rates(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        state = self.spool, self.rate
        return self.spool, {"spool": self.rate, **lags.lag_rates(self.bandwidth, self.damping, state, signal)}


class ValveLagFirstOrder(_Valve):
    """Spool of first order, exact for a held current: s' = w (u - s)."""

    id = "valve_lag"
    options = {"form": ("first_order",)}
    sentence_template = "The spool follows the current with a first-order lag of {bandwidth:.4g} Hz."
    bandwidth = parameter("Hz", 1.0, 2000.0, scale=100.0, neutral=2000.0, fit=_BANDWIDTH)
    spool = hidden("A", scale=1e-3, initial_signal="spool")

    def command(self, spool: Symbol) -> Symbol:
        reach = self.at.hoist(2.0 * np.pi * self.bandwidth * self.at.step)
        left = self.at.hoist(np.exp(-reach))
        self.next["spool"] = spool + (self.spool - spool) * left
        return spool + (self.spool - spool) * self.at.hoist((1.0 - left) / reach)

    def continuous_rates(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        return self.spool, {"spool": 2.0 * np.pi * self.bandwidth * (signal - self.spool)}


class ValveDeadband(_Valve):
    """Symmetric overlap: nothing flows while the spool is within it."""

    id = "valve_deadband"
    sentence_template = "The valve does not open below {half_width:.3g} mA: its edges overlap."
    acts_at_edges = True
    half_width = parameter("A", 0.0, 10.0, scale=5e-4, fit=fit(1e-4, 5e-4, 2e-3, smallest_reported=5e-6, high=0.02))

    def command(self, spool: Symbol) -> Symbol:
        return spool - clip(spool, -self.half_width, self.half_width)


class ValveDeadbandAsymmetric(ValveDeadband):
    """Overlap with a half width on each side: equivalent to a symmetric overlap and a null shift, in one cause."""

    options = {"form": ("lopsided",)}
    sentence_template = (
        "The valve does not open between -{half_width_negative:.3g} mA and {half_width:.3g} mA: its edges overlap."
    )
    half_width = parameter("A", 0.0, 10.0, scale=5e-4, fit=_OVERLAP)
    half_width_negative = parameter("A", 0.0, 10.0, scale=5e-4, fit=_OVERLAP)

    def command(self, spool: Symbol) -> Symbol:
        return spool - clip(spool, -self.half_width_negative, self.half_width)


class ValveDeadbandSoft(ValveDeadband):
    """Overlap whose edges open gradually: each side is a softplus of the spool's excess over the half width."""

    options = {"form": ("soft",)}
    sentence_template = "The valve hardly opens below {half_width:.3g} mA: its edges overlap and open gradually."
    half_width = parameter("A", 0.0, 10.0, scale=5e-4, fit=fit(2e-4, 1e-3, smallest_reported=5e-6, high=0.02))
    softness = parameter("A", 1e-7, 10.0, scale=1e-4, neutral=1e-7,
                         fit=fit(5e-5, 2e-4, low=5e-6, high=5e-3, neutral=1e-4, reported=False))  # fmt: skip

    def command(self, spool: Symbol) -> Symbol:
        beyond, below = spool - self.half_width, -spool - self.half_width
        return self.softness * (_softplus(beyond / self.softness) - _softplus(below / self.softness))


class ValveUnderlap(_Valve):
    """Lands shorter than the ports, an overlap of negative sign: within it both edges of a chamber are open."""

    id = "valve_underlap"
    sentence_template = "The valve's lands are {half_width:.3g} mA short of the ports: at null all four edges are open."
    all_edges = True
    half_width = parameter("A", 0.0, 10.0, scale=1e-4, fit=fit(2e-5, 1e-4, 5e-4, smallest_reported=5e-6, high=0.02))

    def underlap(self, width: Symbol) -> Symbol:
        return width + self.half_width


class ValveEdge(_Valve):
    """One edge whose land differs from the others': its overlap beyond theirs, of either sign, and share of flow."""

    id = "valve_edge"
    options = {"edge": EDGES}
    all_edges = True
    single = True
    overlap = parameter("A", -10.0, 10.0, scale=1e-4,
                        fit=fit(2e-4, 0.0, smallest_reported=5e-6, low=-0.02, high=0.02))  # fmt: skip
    ratio = parameter(
        "-", 0.0, 100.0, scale=0.1, neutral=1.0, fit=fit(0.9, 1.0, smallest_reported=0.004, low=0.0, high=5.0)
    )

    def __init__(self, **chosen: str) -> None:
        super().__init__(**chosen)
        one, other = (_PORTS[port] for port in self.edge)
        self.sentence_template = (
            f"The valve's edge between {one} and {other} opens {{overlap:+.3g}} mA later than the others, and passes "
            "{ratio:.4g} times their flow."
        )

    def land(self, width: Symbol) -> tuple[Symbol, Symbol]:
        return width - self.overlap, self.ratio


class ValveGain(_Valve):
    """Ratio of the valve gain K_v to the bench file's."""

    id = "valve_gain"
    sentence_template = "The valve passes {ratio:.4g} times the flow that the bench file says."
    equivalent_parameter = "valve_nominal_flow"
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0, fit=_RATIO)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        return out * self.ratio, back * self.ratio


class ValveGainAsymmetry(_Valve):
    """Ratio of K_v on the negative side, where the piston is driven back, to that on the positive side."""

    id = "valve_gain_asymmetry"
    sentence_template = "On its negative side the valve passes {ratio:.4g} times the flow of its positive side."
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0, fit=_RATIO)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        return out, back * self.ratio


class ValveGainDrift(_Valve):
    """Drift of the valve gain, K_v (1 + r t), with t since reset or since a recording began."""

    id = "valve_gain_drift"
    sentence_template = "The valve's gain changes while recording, by {rate:.3g} % per second."
    rate = parameter("1/s", -1.0, 1.0, scale=0.01, fit=fit(-0.005, smallest_reported=3e-4, low=-0.2, high=0.2))
    time = hidden("s", scale=10.0)

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        self.next["time"] = self.time + self.at.step
        ratio = clip(1.0 + self.rate * (self.time + 0.5 * self.at.step), DRIFT_MIN, DRIFT_MAX)
        return out * ratio, back * ratio


class ValveNullLeakage(_Valve):
    """Leakage of worn edges around null, of all four by c f(|u|/w); the form is the profile f."""

    id = "valve_null_leakage"
    options = {"form": ("exponential", "gaussian", "hyperbolic", "lorentzian")}
    sentence_template = (
        "Worn edges leak around the valve's null: {coefficient:.3g} ml/s from supply to tank at 1 MPa over each edge."
    )
    all_edges = True
    coefficient = parameter("m3/s/sqrt(Pa)", 0.0, 1e-6, scale=1e-10, fit=fit(3e-10, smallest_reported=2e-12, high=1e-7))
    width = parameter("A", 1e-6, 10.0, scale=1e-3, neutral=1e-3,
                      fit=fit(2e-4, 1e-3, 4e-3, low=2e-5, high=2e-2, neutral=5e-4, reported=False))  # fmt: skip

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        ratio = np.abs(spool) / self.width
        match self.form:
            case "exponential":
                share = np.exp(-ratio)
            case "gaussian":
                share = np.exp(-ratio * ratio)
            case "hyperbolic":
                share = 1.0 / (1.0 + ratio)
            case _:
                share = 1.0 / (1.0 + ratio * ratio)
        wear = self.coefficient * share
        return out + wear, back + wear


def _softplus(ratio: Symbol) -> Symbol:
    return np.fmax(ratio, 0.0) + np.log1p(np.exp(-np.abs(ratio)))


EFFECTS = (
    TransportDelay, ValveOffset, ValveLag, ValveLagFirstOrder, ValveDeadband, ValveDeadbandAsymmetric,
    ValveDeadbandSoft, ValveUnderlap, ValveEdge, ValveGain, ValveGainAsymmetry, ValveGainDrift, ValveNullLeakage,
)  # fmt: skip
