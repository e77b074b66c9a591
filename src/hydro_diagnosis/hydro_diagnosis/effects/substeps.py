# SPDX-License-Identifier: Apache-2.0
"""Means over the substeps of a sample: numpy's own take five times as long over so short an axis."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_sim.jit import njit


def mean(signal: FloatArray) -> FloatArray:
    """Mean over the last axis: from shape (..., substeps) to (...)."""
    return signal[..., 0] if signal.shape[-1] == 1 else _each(signal, _mean)


def mean_beyond(signal: FloatArray, sign: float) -> FloatArray:
    """Mean over the last axis of what `sign` times the signal has above 0, shape (...)."""
    return _each(sign * signal, _mean_above)


def _each(signal: FloatArray, kernel: Callable[[FloatArray, FloatArray], None]) -> FloatArray:
    found = np.empty(signal.shape[:-1])
    kernel(found.reshape(-1), np.ascontiguousarray(signal).reshape(-1, signal.shape[-1]))
    return found


@njit
def _mean(found, signal):
    count = signal.shape[1]
    for k in range(len(found)):
        total = signal[k, 0]
        for s in range(1, count):
            total += signal[k, s]
        found[k] = total / count


@njit
def _mean_above(found, signal):
    count = signal.shape[1]
    for k in range(len(found)):
        total = 0.0
        for s in range(count):
            if signal[k, s] > 0.0:
                total += signal[k, s]
        found[k] = total / count
