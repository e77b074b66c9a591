# SPDX-License-Identifier: Apache-2.0
"""Coordinates that a bench file's loop has beside the eight of `coordinates`: readings that lag, commands on their way.

::

    a pressure sensor's lag    what it shows, and its rate       Pa, Pa/s     the force law reads this, not the pressure
    a dead time                the currents still on their way   N/s          T = 1 ms: the last ceil(time / T) of them

What a sensor shows is counted from the pressure that belongs to f_h: the sum of the pressures has no coordinate. Both
are states of the bench file's model, so that their rows of F and G are of its exact Jacobian. A current counts by the
force rate that it will drive, as the spool does. Without these effects there are none.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, floor, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_bridge.size import Size
from hydro_filter.model.coordinates import Q_HYDRAULIC, Q_SPOOL
from hydro_filter.model.parts import NONE
from hydro_filter.model.terms import Name, state_number
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.sensors import Sensors

CHAMBERS = "ab"
ROUNDING = 1e-9
"""Of a sample: a dead time of whole samples is one."""

POSITION_STATE, VELOCITY_STATE = 2, 3
"""Of the textbook's states."""

UNCERTAINTY = 1.875e-4
"""Standard deviation of the model's pressure after one sample, over the supply's: what the monitor allows."""


class Added(NamedTuple):
    """Added coordinates of a bench."""

    lagging: npt.NDArray[np.int64]
    """Rows, one of each lagging sensor: what it shows, its rate, the pressure (0 or 1); of the whole model."""
    kept: npt.NDArray[np.int64]
    """Numbers of the added coordinates in the loop's model: of sensors, then of currents, the newest first."""
    scale: FloatArray
    """Of each; of currents [N/s]."""
    ages: FloatArray
    """s, 2 d/w of each lagging sensor."""


def added_coordinates(bench: Bench, whole: Mapping[Name, int], loop: Mapping[Name, int], drive: FloatArray) -> Added:
    """Return the added coordinates.

    `bench`: bench file. `whole`, `loop`: numbers of hidden states of the whole and of the loop's model. `drive`:
    `coordinates.loop_scale`.
    """
    lagging, kept, scale, ages = [], [], [], []
    pressure = float(drive[Q_HYDRAULIC]) / bench.piston_area
    for place, chamber in enumerate(CHAMBERS):
        label = f"sensor_lag sensor=pressure_{chamber}"
        if (signal := state_number(whole, label, "signal")) == NONE:
            continue
        bandwidth, damping = next(
            catalogue.kind_of(effect)[1] for effect in bench.effects if catalogue.label(effect) == label
        )
        omega = 2.0 * pi * bandwidth
        lagging.append((signal, state_number(whole, label, "rate"), place))
        kept += [state_number(loop, label, "signal"), state_number(loop, label, "rate")]
        scale += [pressure, omega * pressure]
        ages.append(2.0 * damping / omega)
    on_their_way = currents_on_their_way(bench)
    first = 6 + len(loop)
    kept += range(first, first + on_their_way)
    scale += [float(drive[Q_SPOOL])] * on_their_way
    return Added(
        np.array(lagging, np.int64).reshape(-1, 3), np.array(kept, np.int64), np.array(scale, np.float64),
        np.array(ages, np.float64),
    )  # fmt: skip


def currents_on_their_way(bench: Bench) -> int:
    """Return how many samples' currents have not passed the dead time as a sample begins."""
    return ceil(catalogue.delay(bench.effects) / SAMPLE_PERIOD - ROUNDING)


def current_at_valve(bench: Bench) -> int:
    """Return how many samples before the last one the current was given that is at the valve as a sample ends."""
    return floor(catalogue.delay(bench.effects) / SAMPLE_PERIOD + ROUNDING)


def pressure_observer(model: BenchModel, lagging: npt.NDArray[np.int64], size: Size) -> FloatArray:
    """Gains of the observer of the pressures behind lagging sensors.

    It corrects pressure, what the sensor shows and its rate, of each lagging sensor, twice a sample. By the position's
    error: the box's velocity is late, and what a wrong velocity has done to them goes with what it has done to the
    position. By the readings' errors: the steady Kalman gain of the still bench. Both by the model's exact Jacobian;
    the model's pressure is uncertain by `UNCERTAINTY` a sample, a reading by its noise.

    Parameters
    ----------
    model
        The loop's model.
    lagging
        As `Added.lagging`, of this model.
    size
        Of the bench.

    Returns
    -------
    Columns: pressure, signal, rate of each in turn; rows: per Pa of the readings' errors in turn, per m of the
    position's. Shape (n + 1, 3 n).
    """
    count = len(lagging)
    if not count:
        return np.zeros((1, 0))
    k, rest, _ = model.begin(model.values)
    slopes = model.jacobian(k, rest, 0.0)[1]
    numbers = [number for signal, rate, pressure in lagging for number in (pressure, signal, rate)]
    by_position = slopes[numbers, VELOCITY_STATE] / slopes[POSITION_STATE, VELOCITY_STATE]
    # a wrong pressure moves the position, too, and is corrected as if by a velocity
    moves = slopes[np.ix_(numbers, numbers)] - np.outer(by_position, slopes[POSITION_STATE, numbers])
    noise, uncertain = Sensors.of_size(size).pressure_noise, UNCERTAINTY * size.pressure
    into = slopes[np.ix_(numbers, [pressure for _, _, pressure in lagging])]
    # units of 1 Pa and, of rates, 1 Pa a sample
    units = np.tile([1.0, 1.0, 1.0 / SAMPLE_PERIOD], count)
    moves, into = moves * units / units[:, None], into / units[:, None]
    shown = np.zeros((count, 3 * count))
    shown[np.arange(count), 3 * np.arange(count) + 1] = 1.0
    spread = uncertain**2 * into @ into.T + 1e-6 * noise**2 * np.eye(3 * count)
    known = np.asarray(solve_discrete_are(moves.T, shown.T, spread, noise**2 * np.eye(count)))
    gains = known @ shown.T @ np.linalg.inv(shown @ known @ shown.T + noise**2 * np.eye(count))
    return np.vstack(((units[:, None] * gains).T, by_position))
