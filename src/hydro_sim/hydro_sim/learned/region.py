# SPDX-License-Identifier: Apache-2.0
"""The region in which a model was trained.

The region is an ellipsoid about the training samples in five coordinates that determine the rest: f_l, f_l', p_a, p_b,
u. Its axes are the samples' principal axes, its size the farthest sample's with a margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.jit import njit

COLUMNS = (2, 3, 4, 5)
"""Columns of x that define the region; the valve current is the fifth coordinate."""

MARGIN = 1.2
"""The ellipsoid's half axes over those that hold all training samples."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """An ellipsoid |whiten (q - center)| <= 1 in q = [f_l, f_l', p_a, p_b, u]."""

    center: FloatArray
    """Shape (5,), SI units."""
    whiten: FloatArray
    """Shape (5, 5)."""

    @classmethod
    def about(cls, x: FloatArray, u: FloatArray) -> Region:
        """Return the region of training samples x, shape (n, 8), u, shape (n,)."""
        q = np.column_stack((x[:, COLUMNS], u))
        center = q.mean(axis=0)
        values, axes = np.linalg.eigh(np.corrcoef(q.T))
        whiten = (axes / np.sqrt(np.maximum(values, 1e-6))).T / q.std(axis=0)
        reach = np.linalg.norm((q - center) @ whiten.T, axis=1).max()
        return cls(center=center, whiten=np.ascontiguousarray(whiten / (MARGIN * reach)))

    def distance(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Distance of samples from the center, shape (n,): above 1 is outside."""
        return np.asarray(np.linalg.norm((np.column_stack((x[:, COLUMNS], u)) - self.center) @ self.whiten.T, axis=1))


@njit
def outside(center, whiten, x, u):
    """Return whether one sample, x of shape (8,), lies outside."""
    total = 0.0
    for i in range(5):
        part = whiten[i, 4] * (u - center[4])
        for j in range(4):
            part += whiten[i, j] * (x[COLUMNS[j]] - center[j])
        total += part * part
    return not total <= 1.0  # also of NaN
