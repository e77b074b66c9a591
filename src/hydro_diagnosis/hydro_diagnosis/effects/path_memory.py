# SPDX-License-Identifier: Apache-2.0
"""Dahl's element along a path: a force that follows the direction of motion over a distance, without overshoot."""

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
