# SPDX-License-Identifier: Apache-2.0
"""The bench in closed loop, its references, and its log as a rosbag2 folder.

True states in steps of 5 us, the box and its sensors once a millisecond.

A step is half a step of dry friction, a step of Runge-Kutta of fourth order for all the rest, half a step of friction
(Strang): the set-valued force is never differentiated. A mass that is held creeps by half a step's push, um/s, so that
with dry friction the error falls with the step, not with its square (proof.md has figures).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit

from benchmarks.beyond_the_table.physics import MEMORY, all_rates, brake, misread, rested
from benchmarks.foreign_truth.bench import Numbers, numbers
from benchmarks.foreign_truth.equations import (
    PERIOD,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    STATES,
    VELOCITY,
    command,
    sense,
)
from hydro_bridge.bags.recording import BagWriter
from hydro_core.signals import STATE_DTYPE, STATE_FIELDS

FloatArray = npt.NDArray[np.float64]
SUBSTEPS = 200
LOGGED = 15
"""Columns of a run: those of BenchState from hydraulic_force to integral_gain, then its flags."""
Physics = tuple[int, float, float]
"""Place of a kind in `beyond_the_table.kinds.NAMES`, its magnitude and its second number."""
NONE: Physics = (-1, 0.0, 1.0)


@njit
def advance(physics, bench, time, current, state, step, work):
    """One step of Strang's splitting; `work` has room for three sets of states."""
    slope, between, total = work[0], work[1], work[2]
    brake(physics[0], physics[1], bench, state, 0.5 * step)
    all_rates(physics, bench, time, current, state, total)
    between[:] = total
    for reach, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        for n in range(STATES):
            between[n] = state[n] + reach * step * between[n]
        all_rates(physics, bench, time, current, between, slope)
        for n in range(STATES):
            between[n] = slope[n]
            total[n] += weight * slope[n]
    for n in range(STATES):
        state[n] += step / 6.0 * total[n]
    brake(physics[0], physics[1], bench, state, 0.5 * step)
    state[PRESSURE_A], state[PRESSURE_B] = max(state[PRESSURE_A], -1e5), max(state[PRESSURE_B], -1e5)
    if state[POSITION] < 0.0:
        state[POSITION], state[VELOCITY] = 0.0, max(state[VELOCITY], 0.0)
    if state[POSITION] > bench.stroke:
        state[POSITION], state[VELOCITY] = bench.stroke, min(state[VELOCITY], 0.0)


@njit
def _run(physics, bench, box, reference, gains, noise, quantum, start, substeps, out):
    step, integral, turn = PERIOD / substeps, 0.0, 0
    late = np.zeros(max(math.floor(bench.valve_delay / step + 0.5), 1))
    delayed = bench.valve_delay / step >= 0.5
    state, work = np.zeros(STATES), np.zeros((3, STATES))
    state[PRESSURE_A], state[PRESSURE_B] = start, start / bench.area_ratio
    state[POSITION] = bench.spring_rest_position
    if physics[0] >= 0:
        state[MEMORY] = rested(physics[0], start)
    for k in range(len(out)):
        row, before = out[k], out[max(k - 1, 0)]
        sense(bench, state, noise[k], quantum, row)
        misread(physics[0], physics[1], physics[2], bench, k * PERIOD, state, row)
        for force in (0, 2):
            row[force + 1] = before[force + 1] + 0.2 * ((row[force] - before[force]) / PERIOD - before[force + 1])
        row[7] = before[7] + 0.5 * ((row[6] - before[6]) / PERIOD - before[7])
        row[10], row[11], row[12], row[13] = reference[k, 0], reference[k, 1], gains[0], gains[1]
        integral = command(box, row, integral)
        current = row[8]
        for j in range(substeps):
            acting = current
            if delayed:
                acting, late[turn] = late[turn], current
                turn = (turn + 1) % len(late)
            advance(physics, bench, k * PERIOD + j * step, acting, state, step, work)
        if not math.isfinite(state[PRESSURE_A]):
            return k
    return len(out)


def run(bench: Numbers, reference: FloatArray, *, gains: tuple[float, float] = (80.0, 15.0),
        noise: FloatArray | None = None, quantum: float = 0.0, start: float = 6e6,
        substeps: int = SUBSTEPS, physics: Physics = NONE) -> FloatArray:  # fmt: skip
    """What a box logs that tracks a reference on a bench.

    Parameters
    ----------
    bench
        The truth; the force law believes bench.yaml.
    reference
        Force and its rate [N, N/s], shape (n, 2), one a millisecond.
    gains
        K_p [1/s] and K_i [1/s2].
    noise
        What the force cells and gauges add [N, N, Pa, Pa], shape (n, 4); default: nothing.
    quantum
        m, of the encoder.
    start
        Pa, of chamber A; B balances it, with the piston at the spring's rest.
    physics
        A kind of unnamed physics; its bench has no spool of its own.

    Returns
    -------
    Shape (n, LOGGED).

    Raises
    ------
    ArithmeticError
        The states are no longer finite.
    """
    out = np.zeros((len(reference), LOGGED))
    added = np.zeros((len(reference), 4)) if noise is None else noise
    done = _run(physics, bench, numbers(), reference, gains, added, quantum, start, substeps, out)
    if done < len(out):
        raise ArithmeticError(f"the foreign plant diverges after {done} ms")
    return out


RUNS = {"sines": 80.0, "steps": 65.0}
"""K_p [1/s] by reference: the first is fitted, the second held out. K_i is 15 in both."""
NOISE, QUANTUM = np.array([0.6, 0.6, 6e3, 6e3]), 1e-6
"""N, N, Pa, Pa (standard deviations); m, the encoder's step."""
EPOCH = 1_760_000_000.0


def reference(kind: str, count: int, seed: int) -> FloatArray:
    """Force and its rate [N, N/s], shape (count, 2): a multisine, or filtered steps under a sine that sweeps."""
    time, random = np.arange(count) * PERIOD, np.random.default_rng(seed)
    if kind == "sines":
        force = 220.0 * np.sin(2.0 * np.pi * 1.3 * time)
        for frequency, amplitude in zip((0.37, 0.71, 2.3, 4.1, 6.7, 9.3), (40, 30, 25, 15, 10, 7), strict=True):
            force += amplitude * np.sin(2.0 * np.pi * frequency * time + random.uniform(0.0, 6.28))
    else:
        levels = np.repeat(random.uniform(-280.0, 280.0, count // 700 + 1), 700)[:count]
        smooth = _lag(_lag(levels, 4.0), 4.0)
        force = 0.8 * smooth + 50.0 * np.sin(2.0 * np.pi * (0.5 * time + 1.75 / time[-1] * time**2))
    force *= 1.0 - np.exp(-((time / 0.3) ** 2))
    return np.column_stack([force, np.gradient(force, PERIOD)])


def _lag(signal: FloatArray, bandwidth: float) -> FloatArray:
    """First-order low-pass, from rest."""
    out, share = np.zeros_like(signal), PERIOD * 2.0 * np.pi * bandwidth
    for k in range(1, len(signal)):
        out[k] = out[k - 1] + share * (signal[k] - out[k - 1])
    return out


def write_bag(folder: Path, log: FloatArray) -> None:
    """Write a log, shape (n, LOGGED), as a rosbag2 folder that there is not yet."""
    states = np.zeros(len(log), STATE_DTYPE)
    states["sequence"] = np.arange(len(log))
    states["time"] = EPOCH + PERIOD * states["sequence"]
    for column, name in enumerate(STATE_FIELDS):
        states[name] = log[:, column]
    states["flags"] = log[:, len(STATE_FIELDS)]
    with BagWriter(folder) as bag:
        bag.write_states(states)
