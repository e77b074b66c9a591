# SPDX-License-Identifier: Apache-2.0
"""Elements with memory, filtered over a whole record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit


@njit
def bristle_force(position, stiffness, limit):
    """Return a bristle's force at each position, shape (n,), 0 at the first; `limit`: yield force, shape (n,).

    Within a sample the solution of dF/dx = stiffness (1 - F sign(dx)/limit) is exact. Source: Dahl 1968.
    """
    force = np.zeros(len(position))
    for k in range(1, len(position)):
        moved = position[k] - position[k - 1]
        goal = limit[k] if moved > 0.0 else -limit[k]
        fade = np.exp(-stiffness * abs(moved) / max(abs(limit[k]), 1e-6))
        force[k] = goal + (force[k - 1] - goal) * fade
    return force


def first_order_lag(signal: FloatArray, step: float, time: float, start: float) -> FloatArray:
    """Response of a first-order lag to a zero-order-held signal, shape (n,): means over each interval.

    `step`, `time`: sample period and time constant [s]; `start`: initial value.
    """
    decay = float(np.exp(-step / time))
    begins, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], signal, zi=[start])
    return np.asarray(begins + (1.0 - (1.0 - decay) * time / step) * (signal - begins))


class Memory:
    """Elements with memory over a record sampled every `step` [s], initially in equilibrium with the first sample.

    `other_signals`: signals on which a reading may depend besides its own, by the names of
    `hydro_sim.model.laws.Signals`.
    """

    def __init__(self, step: float, other_signals: Mapping[str, FloatArray] | None = None) -> None:
        self.step = step
        self.other_signals = other_signals or {}

    def lag(self, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        """First-order lag of a signal, `time_constant` in s; the initial state is `start`, or else the first sample.

        The signal is held between samples; the output is the mean over each sample.
        """
        begin = float(signal[0]) if start is None else start
        return first_order_lag(signal, self.step, time_constant, begin)

    def line_pressure(
        self, source: FloatArray, edges: tuple[FloatArray, FloatArray, FloatArray, FloatArray], resistance: float,
        time_constant: float,
    ) -> FloatArray:  # fmt: skip
        """Pressure [Pa] at the end of a line, which falls by `resistance` [Pa s/m3] times the lagged flow drawn.

        `edges`: conductance of one and pressure behind it, then of the other. The flow follows from this pressure: the
        equation of each sample is solved.
        """
        decay = float(np.exp(-self.step / time_constant))
        share = 1.0 - (1.0 - decay) * time_constant / self.step
        return np.asarray(_line_pressure(source, *edges, resistance, decay, share))

    def volume_pressure(
        self, edges: tuple[FloatArray, FloatArray, FloatArray, FloatArray], capacity: float, *, flow: float = 0.0,
        leakage: float = 0.0, most: float = math.inf, outlet: tuple[float, float] = (0.0, 0.0),
    ) -> FloatArray:  # fmt: skip
        """Mean pressure [Pa] over each sample in a volume of oil between the valve's edges and a pump, or an outlet.

        `edges`: as of `line_pressure`; `capacity`: volume over bulk modulus [m3/Pa]; `flow`, `leakage`: of the pump
        [m3/s, m3/s/Pa], up to the pressure `most` [Pa]; `outlet`: its conductance [m3/s/sqrt(Pa)] and the pressure [Pa]
        behind it.
        """
        return np.asarray(_volume_pressure(*edges, *outlet, flow, leakage, most, self.step / capacity))

    def low_pass(self, signal: FloatArray, bandwidth: float, damping: float) -> FloatArray:
        """Second-order low-pass, `bandwidth` in Hz, of a signal that is linear between samples."""
        numerator, denominator = second_order_low_pass(round(bandwidth, 9), round(damping, 9), self.step)
        state = np.multiply.outer(np.cumsum((numerator - denominator)[::-1])[::-1][1:], signal[0])
        passed, _ = lfilter(numerator, denominator, signal, axis=0, zi=state)
        return np.asarray(passed, dtype=np.float64)

    def play(self, position: FloatArray, width: float) -> FloatArray:
        """Output position [m] of the play operator (backlash) of `width` [m], which starts in its middle."""
        return np.asarray(_play(position, width / 2.0))

    def bristle(self, position: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
        """Elastic force [N] of a bristle along `position` [m], with yield force `limit` [N] (Dahl)."""
        return np.asarray(bristle_force(np.ascontiguousarray(position), stiffness, np.ascontiguousarray(limit)))


@njit
def _line_pressure(source, first, behind_first, second, behind_second, resistance, decay, share):
    found = np.empty_like(source)
    lagged = 0.0
    for k in range(-1, len(source)):  # first the steady state of the first sample
        at, part = max(k, 0), share if k >= 0 else 1.0
        one, two = behind_first[at], behind_second[at]
        rest = source[at] - resistance * (1.0 - part) * lagged
        low, high = min(rest, one, two), max(rest, one, two)  # no flow, or that of one direction, at either end
        pressure = min(max(found[max(at - 1, 0)], low), high) if k > 0 else high
        for _ in range(100):
            drops = max(abs(pressure - one), 1e-6), max(abs(pressure - two), 1e-6)
            flow = first[at] * math.copysign(math.sqrt(drops[0]), pressure - one)
            flow += second[at] * math.copysign(math.sqrt(drops[1]), pressure - two)
            beyond = pressure - rest + resistance * part * flow
            if beyond > 0.0:
                high = pressure
            else:
                low = pressure
            slope = 0.5 * (first[at] / math.sqrt(drops[0]) + second[at] / math.sqrt(drops[1]))
            ahead = pressure - beyond / (1.0 + resistance * part * slope)
            if not low <= ahead <= high:  # Newton's step leaves the bracket
                ahead = 0.5 * (low + high)
            moved = abs(ahead - pressure)
            pressure = ahead
            if moved < 1.0:  # Pa: the next step, of Newton, would be nothing
                break
        lagged = flow if k < 0 else flow + (lagged - flow) * decay
        found[at] = pressure
    return found


@njit
def _volume_pressure(first, behind_first, second, behind_second, third, behind_third, flow, leakage, most, rise):
    found = np.empty_like(first)
    begin = most if math.isfinite(most) else behind_third
    for k in range(-1, len(first)):  # first the steady state of the first sample
        at, weight = max(k, 0), 0.5 * rise if k >= 0 else 1e30
        ways = (first[at], behind_first[at]), (second[at], behind_second[at]), (third, behind_third)
        if k < 0:
            low = min(behind_first[at], behind_second[at], behind_third)
            high = max(behind_first[at], behind_second[at], most if math.isfinite(most) else behind_third)
            begin, gain = low, 0.0
        else:
            gain = _net_flow(begin, ways, flow, leakage)[0]
            low, high = min(begin, begin + rise * gain), max(begin, begin + rise * gain)
        pressure = begin
        for _ in range(100):
            net, slope = _net_flow(pressure, ways, flow, leakage)
            beyond = (pressure - begin) / weight - gain - net
            if beyond > 0.0:
                high = pressure
            else:
                low = pressure
            ahead = pressure - beyond / (1.0 / weight - slope)
            if not low <= ahead <= high:  # Newton's step leaves the bracket
                ahead = 0.5 * (low + high)
            moved = abs(ahead - pressure)
            pressure = ahead
            if moved < 0.1:  # Pa
                break
        pressure = min(pressure, most)
        found[at] = 0.5 * (begin + pressure)
        begin = pressure
    return found


@njit
def _net_flow(pressure, ways, flow, leakage):
    """Flow [m3/s] into a volume, and its derivative by the pressure; `ways`: conductance, pressure behind it."""
    flow, slope = flow - leakage * pressure, -leakage
    for conductance, behind in ways:
        drop = pressure - behind
        root = math.sqrt(abs(drop) + 1e3)
        flow -= conductance * drop / root
        slope -= conductance * (abs(drop) * 0.5 + 1e3) / root**3
    return flow, slope


@njit
def _play(position, half):
    dragged = position.copy()
    for k in range(1, len(position)):
        dragged[k] = min(max(dragged[k - 1], position[k] - half), position[k] + half)
    return dragged


@lru_cache(maxsize=256)
def second_order_low_pass(bandwidth: float, damping: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Second-order low-pass, discretised exactly for an input that is linear between samples.

    Returns
    -------
    Numerator and denominator in z^-1, three coefficients each.
    """
    omega = 2.0 * np.pi * bandwidth
    augmented = np.zeros((4, 4))  # position, velocity, input, its slope
    augmented[0, 1] = 1.0
    augmented[1] = [-omega * omega, -2.0 * damping * omega, omega * omega, 0.0]
    augmented[2, 3] = 1.0
    step_map = expm(augmented * step)
    transition = step_map[:2, :2]
    late = step_map[:2, 3] / step
    early = step_map[:2, 2] - late
    trace, determinant = float(np.trace(transition)), float(np.linalg.det(transition))

    # y = C (zI - F)^-1 (early + late z), C = [1, 0]
    def resolvent(vector: FloatArray) -> FloatArray:
        return np.array([vector[0], transition[0, 1] * vector[1] - transition[1, 1] * vector[0]])

    ahead, behind = resolvent(late), resolvent(early)
    numerator = np.array([ahead[0], ahead[1] + behind[0], behind[1]])
    return numerator, np.array([1.0, -trace, determinant])
