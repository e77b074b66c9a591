# SPDX-License-Identifier: Apache-2.0
"""Effects of the valve: overlap, null shift, gain, asymmetry, wear, drift; dead time and spool lag."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Openings, Values, changed
from hydro_diagnosis.effects.kernels import opened
from hydro_sim.model.bench import Bench


class _Valve(Effect):
    equations = ("actuation",)
    family = "valve"
    blocks = frozenset({PRESSURE})
    stage = 2


def _scaled(edges: Openings, positive: FloatArray | float, negative: FloatArray | float) -> Openings:
    return Openings(
        edges.supply_a * positive, edges.a_tank * negative, edges.supply_b * negative, edges.b_tank * positive
    )


class ValveDeadband(_Valve):
    """Overlapped edges: the spool moves by the half width before an edge opens."""

    id = "valve_deadband"
    says = "The valve does not open below {half_width:.3g} mA: its edges overlap."
    parameters = (
        FitParameter(name="half_width", unit="A", low=0.0, high=0.02, probes=(1e-4, 5e-4, 2e-3), smallest=5e-6),
    )

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        width = values["half_width"]
        return current - np.clip(current, -width, width)


class ValveDeadbandLopsided(_Valve):
    """Overlaps of different width: the same as an even overlap and a shifted null, in one cause."""

    id = "valve_deadband"
    says = "The valve does not open between -{half_width_negative:.3g} mA and {half_width:.3g} mA: its edges overlap."
    parameters = tuple(
        FitParameter(name=name, unit="A", low=0.0, high=0.02, probes=(1e-4, 5e-4), smallest=5e-6)
        for name in ("half_width", "half_width_negative")
    )

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        return current - np.clip(current, -values["half_width_negative"], values["half_width"])


class ValveDeadbandSoft(_Valve):
    """An overlap whose edges open gradually: each side is a softplus of the current beyond the half width."""

    id = "valve_deadband"
    says = "The valve hardly opens below {half_width:.3g} mA: its edges overlap and open gradually."
    parameters = (
        FitParameter(name="half_width", unit="A", low=0.0, high=0.02, probes=(2e-4, 1e-3), smallest=5e-6),
        FitParameter(name="softness", unit="A", low=5e-6, high=5e-3, neutral=1e-4, probes=(5e-5, 2e-4), reported=False),
    )

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        return opened(current, values["half_width"], values["softness"])


class ValveOffset(_Valve):
    """Null shift: the spool stands at u + u_0."""

    id = "valve_offset"
    says = "The valve's null is shifted: it acts as if {current:.3g} mA were added to the current."
    stage = 1
    parameters = (FitParameter(name="current", unit="A", low=-0.02, high=0.02, probes=(2e-4,), smallest=4e-6),)

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        return current + values["current"]


_RATIO = FitParameter(name="ratio", unit="-", low=0.2, high=5.0, neutral=1.0, probes=(0.9,), smallest=0.004)


class ValveGain(_Valve):
    """K_v times a ratio."""

    id = "valve_gain"
    says = "The valve passes {ratio:.4g} times the flow that the bench file says."
    parameters = (_RATIO,)

    def openings(self, edges: Openings, spool: FloatArray, time: FloatArray, values: Values) -> Openings:
        return _scaled(edges, values["ratio"], values["ratio"])

    def settled(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, valve_nominal_flow=bench.valve_nominal_flow * values["ratio"])


class ValveGainAsymmetry(_Valve):
    """K_v times a ratio on the negative side alone."""

    id = "valve_gain_asymmetry"
    says = "On its negative side the valve passes {ratio:.4g} times the flow of its positive side."
    parameters = (_RATIO,)

    def openings(self, edges: Openings, spool: FloatArray, time: FloatArray, values: Values) -> Openings:
        return _scaled(edges, 1.0, values["ratio"])


class ValveGainDrift(_Valve):
    """K_v (1 + r t), t from the start of a recording."""

    id = "valve_gain_drift"
    says = "The valve's gain changes while recording, by {rate:.3g} % per second."
    parameters = (FitParameter(name="rate", unit="1/s", low=-0.2, high=0.2, probes=(-0.005,), smallest=3e-4),)

    def openings(self, edges: Openings, spool: FloatArray, time: FloatArray, values: Values) -> Openings:
        ratio = 1.0 + values["rate"] * time
        return _scaled(edges, ratio, ratio)


class ValveNullLeakage(_Valve):
    """Worn edges: every edge stays open by c f(|u|/w) around null; the form is the profile f."""

    id = "valve_null_leakage"
    says = (
        "Worn edges leak around the valve's null: {coefficient:.3g} ml/s from supply to tank at 1 MPa over each edge."
    )
    parameters = (
        FitParameter(name="coefficient", unit="m3/s/sqrt(Pa)", low=0.0, high=1e-7, probes=(3e-10,),
                     smallest=2e-12),
        FitParameter(name="width", unit="A", low=2e-5, high=2e-2, neutral=5e-4, probes=(2e-4, 1e-3, 4e-3),
                     reported=False),
    )  # fmt: skip

    def openings(self, edges: Openings, spool: FloatArray, time: FloatArray, values: Values) -> Openings:
        ratio = np.abs(spool) / values["width"]
        shape = _PROFILES[self.options["form"]](ratio)
        wear = values["coefficient"] * kernels.substep_mean(shape)
        return Openings(edges.supply_a + wear, edges.a_tank + wear, edges.supply_b + wear, edges.b_tank + wear)


_PROFILES = {
    "exponential": lambda ratio: np.exp(-ratio),
    "gaussian": lambda ratio: np.exp(-np.square(ratio)),
    "hyperbolic": lambda ratio: 1.0 / (1.0 + ratio),
    "lorentzian": lambda ratio: 1.0 / (1.0 + np.square(ratio)),
}


class TransportDelay(_Valve):
    """Pure dead time: u(t - T), exact for a current that is held between samples."""

    id = "transport_delay"
    says = "The valve answers the current {time:.3g} ms late, a pure dead time."
    stage = 0
    parameters = (FitParameter(name="time", unit="s", low=0.0, high=0.03, probes=(5e-4, 2e-3, 5e-3), smallest=2e-5),)

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        flat = current.ravel()
        charge = np.concatenate([[0.0], np.cumsum(flat)])
        at = np.arange(len(charge)) - values["time"] / substep
        whole = np.floor(at).astype(np.int64)
        part = at - whole
        low, high = np.clip(whole, 0, len(flat)), np.clip(whole + 1, 0, len(flat))
        delayed = charge[low] * (1.0 - part) + charge[high] * part
        delayed = np.where(at < 0.0, flat[0] * at, delayed)
        shifted: FloatArray = np.diff(delayed).reshape(current.shape)
        return shifted


class ValveLag(_Valve):
    """Spool: s'' + 2 D w s' + w^2 s = w^2 u, sampled exactly for a held current."""

    id = "valve_lag"
    says = "The spool follows the current with a lag: bandwidth {bandwidth:.4g} Hz, damping {damping:.3g}."
    stage = 1
    parameters = (
        FitParameter(name="bandwidth", unit="Hz", low=8.0, high=600.0, neutral=600.0, probes=(40.0, 120.0, 250.0)),
        FitParameter(name="damping", unit="-", low=0.2, high=3.0, neutral=0.8, probes=(0.8,)),
    )

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        numerator, denominator = _spool(round(values["bandwidth"], 9), round(values["damping"], 9), substep)
        flat = current.ravel()
        start = lfilter_steady(numerator, denominator) * flat[0]
        moved, _ = lfilter(numerator, denominator, flat, zi=start)
        return np.asarray(moved, dtype=np.float64).reshape(current.shape)


class ValveLagFirstOrder(_Valve):
    """Spool: s' = w (u - s)."""

    id = "valve_lag"
    says = "The spool follows the current with a first-order lag of {bandwidth:.4g} Hz."
    stage = 1
    parameters = (
        FitParameter(name="bandwidth", unit="Hz", low=8.0, high=600.0, neutral=600.0, probes=(40.0, 120.0, 250.0)),
    )

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        decay = np.exp(-2.0 * np.pi * values["bandwidth"] * substep)
        mean = 1.0 - (1.0 - decay) / (2.0 * np.pi * values["bandwidth"] * substep)
        # mean over a substep: state before it * (1 - mean) + input * mean
        flat = current.ravel()
        before, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], flat, zi=[flat[0]])
        moved: FloatArray = (np.asarray(before) * (1.0 - mean) + flat * mean).reshape(current.shape)
        return moved


def lfilter_steady(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """State of `lfilter` that holds a constant input of 1 at the filter's gain for it."""
    gain = numerator.sum() / denominator.sum()
    state = np.cumsum((numerator - denominator * gain)[::-1])[::-1][1:]
    return np.asarray(state, dtype=np.float64)


@lru_cache(maxsize=256)
def _spool(bandwidth: float, damping: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Transfer function from the held current to its response averaged over the step."""
    omega = 2.0 * np.pi * bandwidth
    system = np.array([[0.0, 1.0], [-omega * omega, -2.0 * damping * omega]])
    # states: position, velocity, integral of position, input
    augmented = np.zeros((4, 4))
    augmented[:2, :2], augmented[1, 3], augmented[2, 0] = system, omega * omega, 1.0
    step_map = expm(augmented * step)
    transition, drive = step_map[:2, :2], step_map[:2, 3]
    output, feed = step_map[2, :2] / step, step_map[2, 3] / step
    trace, determinant = float(np.trace(transition)), float(np.linalg.det(transition))
    denominator = np.array([1.0, -trace, determinant])
    # output (zI - F)^-1 drive + feed, times the denominator
    adjugate = output @ (transition - trace * np.eye(2)) @ drive
    numerator = np.array([feed, output @ drive - trace * feed, adjugate + determinant * feed])
    return numerator, denominator


EFFECTS: tuple[Effect, ...] = (
    ValveDeadband(),
    ValveDeadbandLopsided({"form": "lopsided"}),
    ValveDeadbandSoft({"form": "soft"}),
    ValveOffset(),
    ValveGain(),
    ValveGainAsymmetry(),
    ValveGainDrift(),
    *(ValveNullLeakage({"form": profile}) for profile in _PROFILES),
    TransportDelay(),
    ValveLag(),
    ValveLagFirstOrder({"form": "first_order"}),
)
