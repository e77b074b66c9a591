# SPDX-License-Identifier: Apache-2.0
"""What gradually opening edges pass: a softplus of the current beyond the overlap, on either side."""

from __future__ import annotations

import math

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_sim.jit import njit

STRAIGHT = 40.0
"""Argument beyond which a softplus is its argument, to the last bit."""


def opened(current: FloatArray, width: float, soft: float) -> FloatArray:
    """Current [A] that acts, of the same shape, behind an overlap of half `width` that opens over `soft` [A]."""
    found = np.empty(current.shape)
    _opened(found.reshape(-1), np.ascontiguousarray(current).reshape(-1), width / soft, soft)
    return found


@njit
def _opened(found, current, edge, soft):
    for k in range(len(found)):
        if k > 0 and current[k] == current[k - 1]:  # held over a sample's substeps
            found[k] = found[k - 1]
        else:
            ratio = current[k] / soft
            found[k] = soft * (_softplus(ratio - edge) - _softplus(-ratio - edge))


@njit
def _softplus(over):
    if over > STRAIGHT:
        return over
    return over + math.log1p(math.exp(-over)) if over > 0.0 else math.log1p(math.exp(over))
