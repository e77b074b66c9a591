# SPDX-License-Identifier: Apache-2.0
"""Elements that run along a record: Dahl's, over a path, a lag, and a lag of limited rate."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.jit import njit


@njit
def along(position, stiffness, limit):
    """Force at each of the positions, shape (n,), at rest at the first; `limit`: shape (n,), where it yields.

    Within a sample the solution of dF/dx = stiffness (1 - F sign(dx)/limit) is exact. Source: Dahl 1968.
    """
    force = np.zeros(len(position))
    for k in range(1, len(position)):
        moved = position[k] - position[k - 1]
        goal = limit[k] if moved > 0.0 else -limit[k]
        fade = np.exp(-stiffness * abs(moved) / max(abs(limit[k]), 1e-6))
        force[k] = goal + (force[k - 1] - goal) * fade
    return force


@njit
def limited(signal, step, rate, rising, falling):
    """Means over each step [s], shape (n,), of w' = (s - w) / T within +-rate, for a held signal; at rest first.

    T is `rising` [s] while s is above w, `falling` while it is below.

    Exact: w goes straight while it is further than rate times time from the signal, then exponentially.
    """
    mean = np.empty(len(signal))
    now = signal[0]
    for k in range(len(signal)):
        off = signal[k] - now
        distance = abs(off)
        time = rising if off > 0.0 else falling
        fast = min(max(distance / rate - time, 0.0), step)
        near = distance - rate * fast
        left = np.exp((fast - step) / time)
        area = 0.5 * (distance + near) * fast + near * time * (1.0 - left)
        mean[k] = signal[k] - np.sign(off) * area / step
        now = signal[k] - np.sign(off) * near * left
    return mean


@njit
def turning(signal, step, rising, falling):
    """Lag w' = (s - w) / T of a signal that is straight between samples, shape (n,).

    It begins at the signal. T is `rising` [s] while s is above w, `falling` while it is below: that of its middle is
    taken for each of the parts of a sample, in which the lag is exact.
    """
    parts = 8
    out = np.empty(len(signal))
    now = signal[0]
    out[0] = now
    part = step / parts
    up, down = np.exp(-part / rising), np.exp(-part / falling)
    for k in range(1, len(signal)):
        slope, begin = (signal[k] - signal[k - 1]) / step, signal[k - 1]
        for _ in range(parts):
            rises = begin + 0.5 * slope * part > now
            time = rising if rises else falling
            behind = (now - begin + slope * time) * (up if rises else down) - slope * time
            begin += slope * part
            now = begin + behind
        out[k] = now
    return out


def held_lag(
    signal: FloatArray, step: float, time: float, start: float, falling: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """First-order lag of a held signal, shape (n,), from `start`: where each step [s] begins, and its mean there.

    `falling`: the time [s] while the signal is below what lags, if it is another than `time`.
    """
    decay, share = _held(step, time)
    if falling is None:
        begins, means = _lagged(np.ascontiguousarray(signal), decay, share, start)
    else:
        begins, means = _turned(np.ascontiguousarray(signal), decay, share, *_held(step, falling), start)
    return begins, means


def _held(step: float, time: float) -> tuple[float, float]:
    """What a step leaves of a distance, and the share of it that is gone in the step's mean."""
    decay = float(np.exp(-step / time))
    return decay, 1.0 - (1.0 - decay) * time / step


@njit
def _lagged(signal, decay, share, now):
    begins, means = np.empty(len(signal)), np.empty(len(signal))
    for k in range(len(signal)):
        begins[k] = now
        means[k] = now + share * (signal[k] - now)
        now = decay * now + (1.0 - decay) * signal[k]
    return begins, means


@njit
def _turned(signal, up, share_up, down, share_down, now):
    begins, means = np.empty(len(signal)), np.empty(len(signal))
    for k in range(len(signal)):
        rises = signal[k] > now
        decay = up if rises else down
        begins[k] = now
        means[k] = now + (share_up if rises else share_down) * (signal[k] - now)
        now = decay * now + (1.0 - decay) * signal[k]
    return begins, means
