# SPDX-License-Identifier: Apache-2.0
"""What a run's log of the plant with unnamed physics leaves unexplained, by finite differences.

The equations are those of physics.md: a second derivation, from the log alone, without the plant's code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from benchmarks.beyond_the_table import plant
from benchmarks.beyond_the_table.kinds import NAMES, Kind
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.recordings import reference

FloatArray = npt.NDArray[np.float64]
BENCH, PERIOD, ROWS = numbers(), 1e-3, 3000
START = 6e6
"""Pa, of chamber A."""
QUIET = 300
"""Rows at either end in which the loop starts, or differences have an edge."""
GAIN = BENCH.valve_nominal_flow / BENCH.valve_nominal_current / math.sqrt(BENCH.valve_nominal_pressure_drop / 2.0)
AREA_B, REST = BENCH.area_ratio * BENCH.piston_area, BENCH.spring_rest_position
CORNER = 2.0 * math.pi * BENCH.load_cell_bandwidth


def logged(kind: Kind | None) -> FloatArray:
    """Run without noise and encoder's step, shape (ROWS, LOGGED)."""
    place, size, shape = (-1, 0.0, 1.0) if kind is None else (NAMES.index(kind.name), kind.size[1], kind.shape)
    wanted = reference("sines", ROWS, 3)
    return plant.run(BENCH, place, size, shape, wanted, gain=80.0, noise=np.zeros((ROWS, 4)), quantum=0.0, start=START)


def middle(signal: FloatArray) -> FloatArray:
    """Values halfway between rows."""
    return np.asarray(0.5 * (signal[1:] + signal[:-1]))


def residuals(log: FloatArray) -> dict[str, FloatArray]:
    """What physics.md leaves unexplained in each equation, N and m3/s: at rows, in the chambers halfway between.

    `sensor` and `cell` are what the hydraulic cell and the load's cell read beyond the pressures and the spring.
    """
    hydraulic, cell, a, b, position, current = log[:, [0, 2, 4, 5, 6, 8]].T
    velocity = np.gradient(position, PERIOD)
    load = cell + math.sqrt(2.0) / CORNER * np.gradient(cell, PERIOD) + second(cell) / CORNER**2
    between, out, moved = current[:-1], current[:-1] >= 0.0, np.diff(position) / PERIOD
    into_a = GAIN * between * np.sqrt(np.where(out, BENCH.supply_pressure - middle(a), middle(a)))
    out_of_b = GAIN * between * np.sqrt(np.where(out, middle(b), BENCH.supply_pressure - middle(b)))
    volume_a = BENCH.dead_volume_a + BENCH.piston_area * middle(position)
    volume_b = BENCH.dead_volume_b + AREA_B * (BENCH.stroke - middle(position))
    return {
        "motion": hydraulic - BENCH.viscous_friction * velocity - load - BENCH.moving_mass * second(position),
        "load": load - BENCH.spring_stiffness * (position - BENCH.spring_rest_position),
        "pressure_a": volume_a / BENCH.bulk_modulus * np.diff(a) / PERIOD - into_a + BENCH.piston_area * moved,
        "pressure_b": volume_b / BENCH.bulk_modulus * np.diff(b) / PERIOD + out_of_b - AREA_B * moved,
        "sensor": hydraulic - BENCH.piston_area * a + AREA_B * b,
        "cell": cell - seen(position),
    }


def seen(position: FloatArray) -> FloatArray:
    """What a load's cell would read [N]: the spring's force behind the amplifier, bilinear from row to row."""
    force, grown = BENCH.spring_stiffness * (position - REST), 2.0 / PERIOD / CORNER
    ahead = [1.0 + math.sqrt(2.0) * grown + grown**2, 2.0 - 2.0 * grown**2, 1.0 - math.sqrt(2.0) * grown + grown**2]
    return np.asarray(lfilter([1.0, 2.0, 1.0], ahead, force))


def second(signal: FloatArray) -> FloatArray:
    """Second derivative."""
    return np.concatenate([[0.0], np.diff(signal, 2), [0.0]]) / PERIOD**2


class Signals(NamedTuple):
    """Of a run, shape (ROWS,) each; (ROWS - 1,) halfway between rows, where the current is the earlier row's."""

    a: FloatArray
    b: FloatArray
    x: FloatArray
    v: FloatArray
    u: FloatArray
    """In both cases the current that acts there."""
    f: FloatArray
    """Hydraulic force, as the gauges have it."""


def signals(log: FloatArray, *, halfway: bool) -> Signals:
    hydraulic, a, position, current = log[:, [0, 4, 6, 8]].T
    b = (BENCH.piston_area * a - hydraulic) / AREA_B if not halfway else log[:, 5]
    force = BENCH.piston_area * a - AREA_B * log[:, 5]
    if halfway:
        return Signals(middle(a), middle(b), middle(position), np.diff(position) / PERIOD, current[:-1], middle(force))
    acting = np.concatenate([[0.0], current[:-1]])
    return Signals(a, b, position, np.gradient(position, PERIOD), acting, force)
