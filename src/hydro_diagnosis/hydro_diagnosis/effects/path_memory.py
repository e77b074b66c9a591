# SPDX-License-Identifier: Apache-2.0
"""Elements that run along a record: Dahl's, over a path, and one that follows its signal no faster than a rate."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
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


@njit(cache=True)
def limited(signal, reach):
    """Means over each sample, shape (n,), of what follows a held signal by at most `reach` per sample; at rest first.

    Exact: a straight line up to where the signal is reached.
    """
    mean = np.empty(len(signal))
    now = signal[0]
    for k in range(len(signal)):
        off = signal[k] - now
        within = min(abs(off) / reach, 1.0)
        mean[k] = signal[k] - off * within + np.sign(off) * 0.5 * reach * within * within
        now += min(max(off, -reach), reach)
    return mean
