# SPDX-License-Identifier: Apache-2.0
"""First- and second-order lags sampled exactly: how a state moves on over a step of `step` seconds.

::

    s'' + 2 D w s' + w^2 s = w^2 u          state [s, s'], w = 2 pi bandwidth

    held      u constant over the step      [s, s'] <- F [s, s'] + G u,   mean of s over the step: C [s, s'] + D u
    straight  u from u_0 to u_1             [s, s'] <- F [s, s'] + E u_0 + L u_1
"""

from __future__ import annotations

from math import exp, pi

import numpy as np

from hydro_bridge.signals import FloatArray


def first_order(bandwidth: float, step: float) -> tuple[float, float]:
    """Of s' = w (u - s): what is left of s - u after a step, and its mean over the step."""
    reach = 2.0 * pi * bandwidth * step
    return exp(-reach), (1.0 - exp(-reach)) / reach


def held(bandwidth: float, damping: float, step: float) -> tuple[float, ...]:
    """F row by row (4), G (2), C (2), D of a lag whose input is held."""
    system = np.zeros((4, 4))  # s, s', integral of s, u
    system[:2, :2], system[1, 3], system[2, 0] = _lag(bandwidth, damping), (2.0 * pi * bandwidth) ** 2, 1.0
    moved = _exponential(system * step)
    numbers = [*moved[:2, :2].ravel(), *moved[:2, 3], *moved[2, :2] / step, moved[2, 3] / step]
    return tuple(float(number) for number in numbers)


def straight(bandwidth: float, damping: float, step: float) -> tuple[float, ...]:
    """F row by row (4), E (2), L (2) of a lag whose input is a straight line."""
    system = np.zeros((4, 4))  # s, s', u, u'
    system[:2, :2], system[1, 2], system[2, 3] = _lag(bandwidth, damping), (2.0 * pi * bandwidth) ** 2, 1.0
    moved = _exponential(system * step)
    late = moved[:2, 3] / step
    numbers = [*moved[:2, :2].ravel(), *(moved[:2, 2] - late), *late]
    return tuple(float(number) for number in numbers)


def _lag(bandwidth: float, damping: float) -> FloatArray:
    omega = 2.0 * pi * bandwidth
    return np.array([[0.0, 1.0], [-omega * omega, -2.0 * damping * omega]])


def _exponential(matrix: FloatArray) -> FloatArray:
    from scipy.linalg import expm  # only benches with lags wait for this import

    return np.asarray(expm(matrix), dtype=np.float64)
