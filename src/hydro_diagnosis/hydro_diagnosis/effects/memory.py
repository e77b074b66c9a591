# SPDX-License-Identifier: Apache-2.0
"""Elements with memory: filtered over a whole record, or advanced step by step.

`ColumnMemory` and `WindowMemory` process many windows in parallel: one per column, time along the first axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import numpy.typing as npt
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


def first_order_lag(signal: FloatArray, step: float, time: float, start: float) -> tuple[FloatArray, FloatArray]:
    """Response of a first-order lag to a zero-order-held signal: values at the start of each interval, means over it.

    Both have shape (n,). `step`, `time`: sample period and time constant [s]; `start`: initial value.
    """
    decay = float(np.exp(-step / time))
    begins, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], signal, zi=[start])
    return begins, begins + (1.0 - (1.0 - decay) * time / step) * (signal - begins)


class Memory:
    """Elements with memory over a record sampled every `step` [s], initially in equilibrium with the first sample.

    `other_signals`: signals on which a reading may depend besides its own, by the names of
    `hydro_sim.model.laws.Signals`.
    """

    def __init__(self, step: float, other_signals: Mapping[str, FloatArray] | None = None) -> None:
        self.step = step
        self.other_signals = other_signals or {}
        self.traces: dict[str, FloatArray] = {}
        """States of the elements along the record, by key, from which simulations start."""

    def lag(self, key: str, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        """First-order lag of a signal, `time_constant` in s; the initial state is `start`, or else the first sample.

        The signal is held between samples; the output is the mean over each sample.
        """
        begin = float(signal[0]) if start is None else start
        self.traces[key], mean = first_order_lag(signal, self.step, time_constant, begin)
        return mean

    def low_pass(self, key: str, signal: FloatArray, bandwidth: float, damping: float) -> FloatArray:
        """Second-order low-pass, `bandwidth` in Hz, of a signal that is linear between samples."""
        numerator, denominator = second_order_low_pass(round(bandwidth, 9), round(damping, 9), self.step)
        state = np.multiply.outer(np.cumsum((numerator - denominator)[::-1])[::-1][1:], signal[0])
        passed, _ = lfilter(numerator, denominator, signal, axis=0, zi=state)
        return np.asarray(passed, dtype=np.float64)

    def play(self, key: str, position: FloatArray, width: float) -> FloatArray:
        """Output position [m] of the play operator (backlash) of `width` [m], which starts in its middle."""
        self.traces[key] = _play(position, width / 2.0)
        return self.traces[key]

    def bristle(self, key: str, position: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
        """Elastic force [N] of a bristle along `position` [m], with yield force `limit` [N] (Dahl)."""
        self.traces[key] = bristle_force(np.ascontiguousarray(position), stiffness, np.ascontiguousarray(limit))
        self.traces[key + ".x"] = position
        return self.traces[key]


class StepMemory(Memory):
    """Elements with memory of many windows, advanced in parallel one `step` [s] at a time; `tick` ends a step.

    `low_pass` is not advanced: only sensors need it, and they are applied to the simulated windows as a whole.
    """

    def __init__(self, step: float, states: dict[str, FloatArray]) -> None:
        super().__init__(step)
        self._states = states
        """State of every element, by key; initially those along a record."""
        self._next: dict[str, FloatArray] = {}

    def tick(self) -> None:
        """Advance to the next states, which the last evaluation computed."""
        self._states.update(self._next)

    def lag(self, key: str, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        state = self._states.setdefault(key, signal if start is None else np.full_like(signal, start))
        self._next[key] = state + (signal - state) * (1.0 - np.exp(-self.step / time_constant))
        return state

    def play(self, key: str, position: FloatArray, width: float) -> FloatArray:
        dragged = self._states.setdefault(key, position)
        self._next[key] = np.clip(dragged, position - width / 2.0, position + width / 2.0)
        return self._next[key]

    def bristle(self, key: str, position: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
        where = self._states.setdefault(key + ".x", position)
        force = self._states.setdefault(key, np.zeros_like(position))
        self._next[key], self._next[key + ".x"] = _bent(force, position - where, stiffness, limit), position
        return self._next[key]


def _bent(force: FloatArray, moved: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
    """Force [N] of a bristle after a displacement `moved` [m] from the state `force` [N]."""
    goal = np.sign(moved) * limit
    return np.asarray(goal + (force - goal) * np.exp(-stiffness * np.abs(moved) / np.maximum(limit, 1e-6)))


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


WindowStarts = npt.NDArray[np.int64]
"""Indices of the samples at which windows begin."""


class ColumnMemory(Memory):
    """Elements with memory over many windows, one per column, time along the first axis."""

    def lag(self, key: str, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        single = super().lag
        return np.apply_along_axis(lambda column: single(key, column, time_constant, start), 0, signal)


class WindowMemory(ColumnMemory):
    """Column memory of windows that start along a record, with its states (`traces`) as their initial states."""

    def __init__(self, step: float, other_signals: Mapping[str, FloatArray], traces: dict[str, FloatArray],
                 at: WindowStarts) -> None:  # fmt: skip
        super().__init__(step, other_signals)
        self._along, self._at = traces, at

    def lag(self, key: str, signal: FloatArray, time_constant: float, start: float | None = None) -> FloatArray:
        """Return the record's slow state at the samples of the windows."""
        return self._along[key][self._at]

    def bristle(self, key: str, position: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
        force, where = (self._along[name][self._at[0]] for name in (key, key + ".x"))
        course = np.empty_like(position)
        for k, now in enumerate(position):
            course[k] = force = _bent(force, now - where, stiffness, limit[k])
            where = now
        return course
