# SPDX-License-Identifier: Apache-2.0
"""Parameters of a bench file's effects for the certificate: hidden states, load, sensors, null shifts.

And the coordinates that its loop has beside the eight of `coordinates`: readings that lag, commands on their way.

::

    a pressure sensor's lag    what it shows, and its rate       Pa, Pa/s     the force law reads this, not the pressure
    a dead time                the currents still on their way   N/s          T = 1 ms: the last ceil(time / T) of them

What a sensor shows is counted from the pressure that belongs to f_h: the sum of the pressures has no coordinate. Both
are states of the bench file's model, so that their rows of F and G are of its exact Jacobian. A current counts by the
force rate that it will drive, as the spool does. Without these effects there are none.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, floor, inf, pi
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_core.size import Size
from hydro_filter.model.coordinates import Q_HYDRAULIC, Q_SPOOL
from hydro_filter.model.records import NO_STATE
from hydro_sim.model import rates
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.equations import LOAD_CELL_DAMPING, READINGS
from hydro_sim.model.sensors import Sensors

StateName = tuple[str, int, str]
"""Of a hidden state: its effect's label, which one of several with that label, the state."""

LOAD_CELL_LAG = "sensor_lag sensor=load_force"
_LOAD, _LOAD_RATE = 4, 5  # of the textbook's states: what an amplifier of the bench itself shows


def hidden_state_indices(bench: Bench) -> dict[StateName, int]:
    """Return the index of each hidden state in the bench's model."""
    seen: dict[str, int] = {}
    places: dict[StateName, int] = {}
    for effect in bench.terms:
        label = catalogue.label(effect)
        seen[label] = seen.get(label, -1) + 1
        for state in catalogue.parse_entry(effect)[0].effect.states:
            places[label, seen[label], state.name] = TEXTBOOK + len(places)
    return places


def state_index(numbers: Mapping[StateName, int], label: str, state: str) -> int:
    """Return the index of the first state of this name of an effect whose label begins with `label`, or `NO_STATE`."""
    return next((at for (has, _, name), at in numbers.items() if has.startswith(label) and name == state), NO_STATE)


def load_cell_indices(bench: Bench, numbers: Mapping[StateName, int]) -> tuple[int, int]:
    """Return the indices of the load cell's states, force and rate; `NO_STATE` for the rate of an ideal cell."""
    if (force := state_index(numbers, LOAD_CELL_LAG, "signal")) != NO_STATE:
        return force, state_index(numbers, LOAD_CELL_LAG, "rate")
    return _LOAD, _LOAD_RATE if float(bench.constants()["load_cell_omega"][0]) > 0.0 else NO_STATE


def _made(numbers: Any, effect: Mapping[str, Any], velocity: float = 0.0) -> Effect:
    """An effect with its numbers, for terms that need no state but the velocity [m/s]."""
    kind, values = catalogue.parse_entry(effect)
    made = kind.make()
    made.at = SimpleNamespace(numbers=numbers, velocity=velocity)
    for parameter, value in zip(kind.parameters, values, strict=True):
        setattr(made, parameter.name, value)
    return made


def load_curve(record: Any, effects: list[Mapping[str, Any]], positions: FloatArray) -> FloatArray:
    """Return the load force f_l [N] at `positions` [m], without backlash."""
    numbers = SimpleNamespace(**{name: float(record[name]) for name in record.dtype.names})
    force = rates.load_force(numbers, [_made(numbers, effect) for effect in effects], positions)
    return np.asarray(force, np.float64)


def depends_on_velocity(bench: Bench, effect: Mapping[str, Any]) -> bool:
    """Return whether an effect of the load without states depends on the velocity."""
    positions = np.linspace(0.0, bench.stroke, 9)
    still, out, back = (
        _made(bench, effect, velocity).load(0.0 * positions, positions) for velocity in (0.0, 0.1, -0.1)
    )
    return not (np.array_equal(still, out) and np.array_equal(still, back))


def sensor_calibration(truth: Bench) -> tuple[FloatArray, FloatArray]:
    """Return gain and bias of the five readings, shape (5,) each."""
    made = [_made(None, effect) for effect in truth.effects]
    ends = np.array([[0.0] * len(READINGS), [1.0] * len(READINGS)])
    for effect in made:
        ends = np.array([[effect.read_sensor(name, z) for name, z in zip(READINGS, row, strict=True)] for row in ends])
    return ends[1] - ends[0], ends[0]


def null_shifts(truth: Bench) -> tuple[float, float]:
    """Return the null shifts [A] before and after the valve's lag, in the order of the bench file."""
    shifts, behind = [0.0, 0.0], False
    for effect in truth.effects:
        behind = behind or effect["id"] == "valve_lag"
        if effect["id"] == "valve_offset":
            shifts[int(behind)] += catalogue.parse_entry(effect)[1][0]
    return shifts[0], shifts[1]


def load_cell_coefficients(truth: Bench) -> tuple[float, float]:
    """Return the coefficients 2 d/w [s] and 1/w^2 [s^2] of the load cell's amplifier."""
    for effect in truth.effects:
        if catalogue.label(effect) == LOAD_CELL_LAG:
            bandwidth, damping = catalogue.parse_entry(effect)[1]
            return 2.0 * damping / (2.0 * pi * bandwidth), (2.0 * pi * bandwidth) ** -2
    omega = float(truth.constants()["load_cell_omega"][0]) or inf
    return 2.0 * LOAD_CELL_DAMPING / omega, 1.0 / omega**2


def valve_lag_time(truth: Bench) -> float:
    """Return the delay [s] of the valve's lag at low frequency: 2 d/w, or 1/w of a first-order lag."""
    for effect in truth.effects:
        if effect["id"] == "valve_lag":
            bandwidth, *damping = catalogue.parse_entry(effect)[1]
            return (2.0 * damping[0] if damping else 1.0) / (2.0 * pi * bandwidth)
    return 0.0


CHAMBERS = "ab"
ROUNDING = 1e-9
"""Of a sample: a dead time of whole samples is one."""

POSITION_STATE, VELOCITY_STATE = 2, 3
"""Of the textbook's states."""

UNCERTAINTY = 1.875e-4
"""Standard deviation of the model's pressure after one sample, over the supply's: what the monitor allows."""


class AddedCoordinates(NamedTuple):
    """Coordinates that a bench's sensor lags and dead time add to the common eight."""

    lagging: npt.NDArray[np.int64]
    """Rows, one of each lagging sensor: what it shows, its rate, the pressure (0 or 1); of the whole model."""
    kept: npt.NDArray[np.int64]
    """Numbers of the added coordinates in the loop's model: of sensors, then of currents, the newest first."""
    scale: FloatArray
    """Of each; of currents [N/s]."""
    ages: FloatArray
    """s, 2 d/w of each lagging sensor."""


def added_coordinates(
    bench: Bench, whole: Mapping[StateName, int], loop: Mapping[StateName, int], drive: FloatArray
) -> AddedCoordinates:
    """Return the coordinates that a bench adds to the common eight.

    `bench`: bench file. `whole`, `loop`: numbers of hidden states of the whole and of the loop's model. `drive`:
    `coordinates.coordinate_scales`.
    """
    lagging, kept, scale, ages = [], [], [], []
    pressure = float(drive[Q_HYDRAULIC]) / bench.piston_area
    for place, chamber in enumerate(CHAMBERS):
        label = f"sensor_lag sensor=pressure_{chamber}"
        if (signal := state_index(whole, label, "signal")) == NO_STATE:
            continue
        bandwidth, damping = next(
            catalogue.parse_entry(effect)[1] for effect in bench.effects if catalogue.label(effect) == label
        )
        omega = 2.0 * pi * bandwidth
        lagging.append((signal, state_index(whole, label, "rate"), place))
        kept += [state_index(loop, label, "signal"), state_index(loop, label, "rate")]
        scale += [pressure, omega * pressure]
        ages.append(2.0 * damping / omega)
    on_their_way = count_delayed_currents(bench)
    first = 6 + len(loop)
    kept += range(first, first + on_their_way)
    scale += [float(drive[Q_SPOOL])] * on_their_way
    return AddedCoordinates(
        np.array(lagging, np.int64).reshape(-1, 3), np.array(kept, np.int64), np.array(scale, np.float64),
        np.array(ages, np.float64),
    )  # fmt: skip


def count_delayed_currents(bench: Bench) -> int:
    """Return the number of past currents still within the dead time at the beginning of a sample."""
    return ceil(catalogue.total_delay(bench.effects) / SAMPLE_PERIOD - ROUNDING)


def dead_time_samples(bench: Bench) -> int:
    """Return the dead time in whole samples: the age of the current at the valve at the end of a sample."""
    return floor(catalogue.total_delay(bench.effects) / SAMPLE_PERIOD + ROUNDING)


def pressure_observer(model: BenchModel, lagging: npt.NDArray[np.int64], size: Size) -> FloatArray:
    """Return the gains of the observer of pressures behind lagging sensors.

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
