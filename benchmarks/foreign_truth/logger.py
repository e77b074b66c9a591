# SPDX-License-Identifier: Apache-2.0
"""A logger of its own beside the box: the true bench every 100 us, of which any rate and any jitter can be taken.

At the box's milliseconds a row is what the box itself has read and decided; between them the sensors have fresh noise
and the current is held.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.box import PERIOD, command, sense
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, STATES
from benchmarks.foreign_truth.plant import LOGGED, NONE, FloatArray, advance
from benchmarks.foreign_truth.recordings import FORCE_NOISE, PRESSURE_NOISE, QUANTUM, RUNS, reference

ROWS = 10
"""A millisecond: 10 kHz."""
SUBSTEPS = 10
"""Of a row: 10 us."""


@njit
def _run(bench, box, wanted, gains, noise, quantum, start, out):
    step, integral = PERIOD / ROWS / SUBSTEPS, 0.0
    state, work, before = np.zeros(STATES), np.zeros((3, STATES)), np.zeros(LOGGED)
    state[PRESSURE_A], state[PRESSURE_B] = start, start / bench.area_ratio
    state[POSITION] = bench.spring_rest_position
    for k in range(len(out)):
        row = out[k]
        sense(bench, state, noise[k], quantum, row)
        if k % ROWS == 0:
            tick = k // ROWS
            row[7] = before[7] + 0.5 * ((row[6] - before[6]) / PERIOD - before[7])
            row[10], row[11], row[12], row[13] = wanted[tick, 0], wanted[tick, 1], gains[0], gains[1]
            integral = command(box, row, integral)
            before = row
        row[8] = before[8]
        for j in range(SUBSTEPS):
            advance(NONE, bench, k * PERIOD / ROWS + j * step, row[8], state, step, work)


def logged(truth: dict[str, float], number: int, seed: int, seconds: float) -> FloatArray:
    """Everything that a bench of this truth shows in a run of this number, shape (10000 `seconds`, LOGGED)."""
    kind, gain = list(RUNS.items())[number]
    count = round(seconds / PERIOD)
    deviations = np.array([FORCE_NOISE, FORCE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE])
    noise = deviations * np.random.default_rng([seed, number]).standard_normal((count * ROWS, 4))
    out = np.zeros((count * ROWS, LOGGED))
    wanted = reference(kind, count, 10 * seed + number)
    _run(numbers(**truth), numbers(), wanted, (gain, 15.0), noise, QUANTUM, 6e6 + 4e5 * number, out)
    if not np.all(np.isfinite(out[-1])):
        raise ArithmeticError("the foreign plant diverges")
    return out
