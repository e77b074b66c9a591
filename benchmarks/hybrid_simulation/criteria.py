# SPDX-License-Identifier: Apache-2.0
"""Criteria of the benchmark: how well the actuator follows, and what that does to the building."""

from __future__ import annotations

import numpy as np

from benchmarks.hybrid_simulation.motions import STEP
from hydro_core.signals import FloatArray

DELAYS = 50
"""Delays in samples, from 0, among which J1 looks."""
CRITERIA = {
    "j1": "ms, delay of x_m behind x_n1 with the largest correlation",
    "j2": "%, standard deviation of x_m - x_n1, over that of x_n1",
    "j3": "%, largest |x_m - x_n1|, over the largest |x_n1|",
    "j4": "%, as j2, of x_m - x_r1 over x_r1",
    "j5": "%, as j3, of x_m - x_r1 over x_r1",
    "j6": "%, as j2, of x_n2 - x_r2 over x_r2",
    "j7": "%, as j6, floor 3",
    "j8": "%, as j3, of x_n2 - x_r2 over x_r2",
    "j9": "%, as j8, floor 3",
    "j2_true": "%, as j2, with the true displacement x in place of x_m",
}
"""x_m: measured displacement of the actuator; x_n: floors as simulated; x_r: floors of the whole building."""


def criteria(simulated: FloatArray, true: FloatArray, measured: FloatArray, reference: FloatArray) -> dict[str, float]:
    """Return the criteria, as F4_evaluation_PI.m of the public files has them, without their rounding.

    Parameters
    ----------
    simulated, reference
        x_n and x_r [m], shape (n, 3).
    true, measured
        x and x_m [m], shape (n,).
    """
    target, whole = simulated[:, 0], reference[:, 0]
    correlations = [np.corrcoef(measured[d:], target[: len(target) - d])[0, 1] for d in range(DELAYS)]
    return {
        "j1": 1e3 * STEP * int(np.argmax(correlations)),
        "j2": _spread(measured - target, target), "j3": _peak(measured - target, target),
        "j4": _spread(measured - whole, whole), "j5": _peak(measured - whole, whole),
        "j6": _spread(simulated[:, 1] - reference[:, 1], reference[:, 1]),
        "j7": _spread(simulated[:, 2] - reference[:, 2], reference[:, 2]),
        "j8": _peak(simulated[:, 1] - reference[:, 1], reference[:, 1]),
        "j9": _peak(simulated[:, 2] - reference[:, 2], reference[:, 2]),
        "j2_true": _spread(true - target, target),
    }  # fmt: skip


def _spread(error: FloatArray, signal: FloatArray) -> float:
    return 100.0 * float(np.std(error) / np.std(signal))


def _peak(error: FloatArray, signal: FloatArray) -> float:
    return 100.0 * float(np.abs(error).max() / np.abs(signal).max())
