# SPDX-License-Identifier: Apache-2.0
"""One step of Adam (Kingma and Ba, 2015, algorithm 1), compiled; used wherever gradients are written by hand.

::

    m += (1 - beta_1) (g - m)    s += (1 - beta_2) (g^2 - s)
    w -= rate / (1 - beta_1^n) m / (sqrt(s / (1 - beta_2^n)) + epsilon)      n: number of the step, from 1
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy.typing as npt

from hydro_sim.jit import njit
from hydro_sim.neural.dense import LOOSE

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class Adam(NamedTuple):
    """One optimizer: flat vectors of one type, shape (n,), changed in place."""

    parameters: npt.NDArray[Any]
    gradient: npt.NDArray[Any]
    first_moment: npt.NDArray[Any]
    second_moment: npt.NDArray[Any]
    learning_rate: float
    steps: int
    """Steps done before this call."""


@njit(fastmath=LOOSE)
def step(adam, count):
    """Update the parameters by `adam.gradient`, as torch.optim.Adam does; this is step `adam.steps + count`."""
    kind = adam.parameters.dtype.type
    number = adam.steps + count
    rate = kind(adam.learning_rate / (1.0 - BETA_1**number))
    root = kind(1.0 / math.sqrt(1.0 - BETA_2**number))
    old_1, new_1, old_2, new_2 = kind(BETA_1), kind(1.0 - BETA_1), kind(BETA_2), kind(1.0 - BETA_2)
    epsilon = kind(EPSILON)
    for i in range(len(adam.parameters)):
        g = adam.gradient[i]
        adam.first_moment[i] = old_1 * adam.first_moment[i] + new_1 * g
        adam.second_moment[i] = old_2 * adam.second_moment[i] + new_2 * g * g
        adam.parameters[i] -= rate * adam.first_moment[i] / (math.sqrt(adam.second_moment[i]) * root + epsilon)
