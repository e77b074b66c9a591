# SPDX-License-Identifier: Apache-2.0
"""The foreign bench in closed loop with one kind of unnamed physics, in steps of 10 us."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from benchmarks.beyond_the_table.physics.load import brake
from benchmarks.beyond_the_table.physics.places import MEMORY
from benchmarks.beyond_the_table.physics.rates import all_rates, rested
from benchmarks.beyond_the_table.physics.sensors import misread
from benchmarks.foreign_truth.bench import Numbers, numbers
from benchmarks.foreign_truth.box import PERIOD, command, sense
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from benchmarks.foreign_truth.plant import LOGGED

FloatArray = npt.NDArray[np.float64]
SUBSTEPS = 100
SPREAD = 1e-3
"""s over which a hysteretic valve takes a step of the current: its path, not its time, is what counts."""


@njit
def _step(kind, size, shape, bench, time, current, slope, state, step, work):
    first, between, total = work[0], work[1], work[2]
    brake(kind, size, bench, state, 0.5 * step)
    all_rates(kind, size, shape, bench, time, current, slope, state, total)
    between[:] = total
    for reach, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        for n in range(STATES):
            between[n] = state[n] + reach * step * between[n]
        all_rates(kind, size, shape, bench, time, current, slope, between, first)
        for n in range(STATES):
            between[n] = first[n]
            total[n] += weight * first[n]
    for n in range(STATES):
        state[n] += step / 6.0 * total[n]
    brake(kind, size, bench, state, 0.5 * step)
    state[PRESSURE_A], state[PRESSURE_B] = max(state[PRESSURE_A], -1e5), max(state[PRESSURE_B], -1e5)
    if state[POSITION] < 0.0:
        state[POSITION], state[VELOCITY] = 0.0, max(state[VELOCITY], 0.0)
    if state[POSITION] > bench.stroke:
        state[POSITION], state[VELOCITY] = bench.stroke, min(state[VELOCITY], 0.0)


@njit
def _run(kind, size, shape, bench, box, reference, gains, noise, quantum, start, substeps, out):
    step, integral, last = PERIOD / substeps, 0.0, 0.0
    state, work = np.zeros(STATES), np.zeros((3, STATES))
    state[PRESSURE_A], state[PRESSURE_B] = start, start / bench.area_ratio
    state[POSITION], state[MEMORY] = bench.spring_rest_position, rested(kind, bench, start)
    for k in range(len(out)):
        row, before = out[k], out[max(k - 1, 0)]
        sense(bench, state, noise[k], quantum, row)
        misread(kind, size, shape, bench, k * PERIOD, last, state, row)
        for force in (0, 2):
            row[force + 1] = before[force + 1] + 0.2 * ((row[force] - before[force]) / PERIOD - before[force + 1])
        row[7] = before[7] + 0.5 * ((row[6] - before[6]) / PERIOD - before[7])
        row[10], row[11], row[12], row[13] = reference[k, 0], reference[k, 1], gains[0], gains[1]
        integral = command(box, row, integral)
        slope, last = (row[8] - last) / SPREAD, row[8]
        for j in range(substeps):
            _step(kind, size, shape, bench, k * PERIOD + j * step, row[8], slope, state, step, work)
        if not math.isfinite(state[PRESSURE_A]):
            return k
    return len(out)


def run(bench: Numbers, kind: int, size: float, shape: float, reference: FloatArray, *, gain: float, noise: FloatArray,
        quantum: float = 1e-6, start: float = 6e6, substeps: int = SUBSTEPS) -> FloatArray:  # fmt: skip
    """What the box logs on a bench with a kind of unnamed physics.

    Parameters
    ----------
    bench
        The truth; the force law believes bench.yaml.
    kind, size, shape
        Place in `NAMES` (-1: none), magnitude and second number.
    reference
        Force and its rate [N, N/s], shape (n, 2), one a millisecond.
    gain
        K_p [1/s]; K_i is 15.
    noise
        What the force cells and gauges add [N, N, Pa, Pa], shape (n, 4).
    quantum, start
        m, of the encoder; Pa, of chamber A.

    Returns
    -------
    Shape (n, LOGGED).

    Raises
    ------
    ArithmeticError
        The states are no longer finite.
    """
    out = np.zeros((len(reference), LOGGED))
    done = _run(kind, size, shape, bench, numbers(), reference, (gain, 15.0), noise, quantum, start, substeps, out)
    if done < len(out):
        raise ArithmeticError(f"the plant diverges after {done} ms")
    return out
