# SPDX-License-Identifier: Apache-2.0
"""References of the two runs of a case, and a log as a rosbag2 folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.foreign_truth.box import PERIOD
from benchmarks.foreign_truth.plant import FloatArray
from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE, STATE_FIELDS, StateArray

RUNS = {"sines": 80.0, "steps": 65.0}
"""K_p [1/s] by reference: the first is fitted, the second held out. K_i is 15 in both."""
FORCE_NOISE, PRESSURE_NOISE, QUANTUM = 0.6, 6e3, 1e-6
"""N and Pa (standard deviations), m (step of the encoder), at noise 1."""
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
    with BagWriter(folder) as bag:
        bag.write_states(states_of(log))


def states_of(log: FloatArray) -> StateArray:
    """A log, shape (n, LOGGED), as a recording holds it."""
    states = np.zeros(len(log), STATE_DTYPE)
    states["sequence"] = np.arange(len(log))
    states["time"] = EPOCH + PERIOD * states["sequence"]
    for column, name in enumerate(STATE_FIELDS):
        states[name] = log[:, column]
    states["flags"] = log[:, len(STATE_FIELDS)]
    return states
