# SPDX-License-Identifier: Apache-2.0
"""Dynamic effects of the valve: dead time of the command, lag of the spool."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Values


class TransportDelay(Effect):
    """Pure dead time: u(t - T), exact for a current that is held between samples."""

    id = "transport_delay"
    stage = 0
    equations = ("actuation",)
    family = "valve"
    touches = frozenset({PRESSURE})
    parameters = (
        FitParameter(name="time", unit="s", low=0.0, high=0.03, neutral=0.0, probes=(5e-4, 2e-3, 5e-3), smallest=2e-5),
    )

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

    def sentence(self, values: Values) -> str:
        return f"The valve answers the current {values['time'] * 1e3:.3g} ms late, a pure dead time."


class ValveLag(Effect):
    """Spool: s'' + 2 D w s' + w^2 s = w^2 u, sampled exactly for a held current."""

    id = "valve_lag"
    equations = ("actuation",)
    family = "valve"
    touches = frozenset({PRESSURE})
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

    def sentence(self, values: Values) -> str:
        return (
            f"The spool follows the current with a lag: bandwidth {values['bandwidth']:.4g} Hz, "
            f"damping {values['damping']:.3g}."
        )


class ValveLagFirstOrder(Effect):
    """Spool: s' = w (u - s)."""

    id = "valve_lag"
    equations = ("actuation",)
    family = "valve"
    touches = frozenset({PRESSURE})

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

    def sentence(self, values: Values) -> str:
        return f"The spool follows the current with a first-order lag of {values['bandwidth']:.4g} Hz."


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


EFFECTS: tuple[Effect, ...] = (TransportDelay(), ValveLag(), ValveLagFirstOrder({"form": "first_order"}))
