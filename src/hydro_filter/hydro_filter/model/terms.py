# SPDX-License-Identifier: Apache-2.0
"""Terms of the certificate from a bench file's effects: hidden states, load, sensors, valve, added coordinates.

The loop has coordinates in addition to the eight of `coordinates` for lagging readings and delayed currents::

    a pressure sensor's lag    its output, and the output's rate  Pa, Pa/s    the force law reads this, not the pressure
    a dead time                the currents still on their way    N/s         T = 1 ms: the last ceil(time / T) of them

A sensor's output is taken relative to the pressure that belongs to f_h: the sum of the pressures has no coordinate.
Both are states of the bench file's model, so that their rows of F and G are of its exact Jacobian. A current is in
units of the force rate that it will drive, as the spool is. Without these effects there are no added coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, pi
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from hydro_core.bench_scales import BenchScales
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.model.records import NO_STATE
from hydro_sim.model import rates
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK_STATE_COUNT, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.equations import LOAD_CELL_DAMPING, READINGS
from hydro_sim.model.sensors import Sensors

StateName = tuple[str, int, str]
"""Key of a hidden state: its effect's label, index among the effects with this label, name of the state."""
VALVE_LAG, LOAD_CELL_LAG, FORCE_CELL_LAG = (
    "valve_lag", "sensor_lag sensor=load_force", "sensor_lag sensor=hydraulic_force",
)  # fmt: skip
PRESSURE_LAGS = "sensor_lag sensor=pressure_a", "sensor_lag sensor=pressure_b"
"""Labels of the lags of chamber A's and chamber B's pressure sensor."""
POSITION_STATE, VELOCITY_STATE, LOAD_STATE, LOAD_RATE_STATE = 2, 3, 4, 5
"""Indices of the textbook model's states; load force and its rate are behind the bench's own amplifier."""
PRESSURE_UNCERTAINTY = 1.875e-4
"""Standard deviation of the model's pressure after one sample, over the bench's pressure; the monitor's allowance."""


def parameters_of(effect: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters of a bench file's entry by name."""
    kind, values = catalogue.parse_entry(effect)
    return {one.name: value for one, value in zip(kind.parameters, values, strict=True)}


def find_parameters(bench: Bench, label: str) -> dict[str, float]:
    """Return the parameters of the first effect whose label begins with `label`, by name; empty if there is none."""
    return next((parameters_of(one) for one in bench.effects if catalogue.label(one).startswith(label)), {})


def lag_delay(lag: Mapping[str, float]) -> float:
    """Return the delay [s] of a lag at low frequency: 2 d/w, 1/w if it is of first order, 0 without parameters."""
    return (2.0 * lag["damping"] if "damping" in lag else 1.0) / (2.0 * pi * lag["bandwidth"]) if lag else 0.0


def hidden_state_indices(bench: Bench) -> dict[StateName, int]:
    """Return the index of each hidden state in the bench's model."""
    seen: dict[str, int] = {}
    indices: dict[StateName, int] = {}
    for effect in bench.terms:
        label = catalogue.label(effect)
        seen[label] = seen.get(label, -1) + 1
        for state in catalogue.parse_entry(effect)[0].effect.states:
            indices[label, seen[label], state.name] = TEXTBOOK_STATE_COUNT + len(indices)
    return indices


def state_index(indices: Mapping[StateName, int], label: str, state: str) -> int:
    """Return the index of the first state of this name of an effect whose label begins with `label`, or `NO_STATE`."""
    return next((at for (has, _, name), at in indices.items() if has.startswith(label) and name == state), NO_STATE)


def load_cell_indices(bench: Bench, indices: Mapping[StateName, int]) -> tuple[int, int]:
    """Return the indices of the load cell's states, force and rate; `NO_STATE` for the rate of an ideal cell."""
    if (force := state_index(indices, LOAD_CELL_LAG, "signal")) != NO_STATE:
        return force, state_index(indices, LOAD_CELL_LAG, "rate")
    return LOAD_STATE, LOAD_RATE_STATE if float(bench.constants()["load_cell_omega"][0]) > 0.0 else NO_STATE


def load_cell_coefficients(bench: Bench) -> tuple[float, float]:
    """Return the coefficients 2 d/w [s] and 1/w^2 [s^2] of the load cell's amplifier."""
    if lag := find_parameters(bench, LOAD_CELL_LAG):
        return lag_delay(lag), (2.0 * pi * lag["bandwidth"]) ** -2
    omega = float(bench.constants()["load_cell_omega"][0]) or inf
    return 2.0 * LOAD_CELL_DAMPING / omega, 1.0 / omega**2


def load_curve(record: Any, effects: Sequence[Mapping[str, Any]], positions: FloatArray) -> FloatArray:
    """Return the load force f_l [N] at `positions` [m], without backlash."""
    bench = SimpleNamespace(**{name: float(record[name]) for name in record.dtype.names})
    force = rates.load_force(bench, [_evaluable(effect, bench) for effect in effects], positions)
    return np.asarray(force, np.float64)


def depends_on_velocity(bench: Bench, effect: Mapping[str, Any]) -> bool:
    """Return whether the load force of an effect without hidden states depends on the velocity."""
    positions = np.linspace(0.0, bench.stroke, 9)
    still, *moving = (_evaluable(effect, bench, v).load(0.0 * positions, positions) for v in (0.0, 0.1, -0.1))
    return not all(np.array_equal(still, one) for one in moving)


def sensor_calibration(bench: Bench) -> tuple[FloatArray, FloatArray]:
    """Return gain and bias of the five readings, shape (5,) each."""
    ends = np.array([np.zeros(len(READINGS)), np.ones(len(READINGS))])
    for one in (_evaluable(effect, None) for effect in bench.effects):
        ends = np.array([[one.read_sensor(name, z) for name, z in zip(READINGS, row, strict=True)] for row in ends])
    return ends[1] - ends[0], ends[0]


def _evaluable(effect: Mapping[str, Any], bench: Any, velocity: float = 0.0) -> Effect:
    """Return an effect with its parameters' values, for terms that need no state but the velocity [m/s]."""
    return catalogue.parse_entry(effect)[0].bind(parameters_of(effect), bench=bench, velocity=velocity)


def dry_friction(bench: Bench) -> float:
    """Return the level [N] up to which dry friction holds the piston."""
    dry = [parameters_of(one) for one in bench.effects if one["id"] in ("friction_coulomb", "friction_stribeck")]
    return sum(max(value for name, value in each.items() if "force" in name) for each in dry)


class LaggingSensor(NamedTuple):
    """Pressure sensor with a lag."""

    chamber: int
    """0: p_a, 1: p_b."""
    signal_index: int
    """Index of its output in the whole model."""
    rate_index: int
    linear_signal_index: int
    """Index of its output in the loop's model."""
    linear_rate_index: int
    omega: float
    """Natural frequency [rad/s]."""
    delay: float
    """Delay [s] at low frequency, as `lag_delay`."""


def lagging_sensors(
    bench: Bench, whole: Mapping[StateName, int], linear: Mapping[StateName, int]
) -> list[LaggingSensor]:
    """Return the bench's lagging pressure sensors; `whole`, `linear`: `hidden_state_indices` of the two models."""
    found = []
    for chamber, label in enumerate(PRESSURE_LAGS):
        if lag := find_parameters(bench, label):
            signal, rate, linear_signal, linear_rate = (
                state_index(of, label, name) for of in (whole, linear) for name in ("signal", "rate")
            )
            omega = 2.0 * pi * lag["bandwidth"]
            found.append(LaggingSensor(chamber, signal, rate, linear_signal, linear_rate, omega, lag_delay(lag)))
    return found


def pressure_observer(model: BenchModel, sensors: Sequence[LaggingSensor], size: BenchScales) -> FloatArray:
    """Return the gains of the observer of pressures behind lagging sensors.

    The observer corrects pressure, sensor output and its rate, of each lagging sensor, twice a sample. The position's
    error counts because the box's velocity is late: a velocity error changes these states in proportion to the
    position. The readings' errors enter by the steady Kalman gain of the bench at rest. Both gains are by the model's
    exact Jacobian; the pressure's process noise is `PRESSURE_UNCERTAINTY` a sample, measurement noise that of the
    reading.

    Parameters
    ----------
    model
        The loop's model, without disturbances.
    sensors
        One or two lagging sensors.
    size
        Size of the bench.

    Returns
    -------
    Columns: pressure, signal, rate of each in turn; rows: per Pa of the readings' errors in turn, per m of the
    position's. Shape (n + 1, 3 n).
    """
    count = len(sensors)
    k, rest, _ = model.begin(model.values)
    slopes = model.jacobian(k, rest, 0.0)[1]
    states = [index for one in sensors for index in (one.chamber, one.linear_signal_index, one.linear_rate_index)]
    by_position = slopes[states, VELOCITY_STATE] / slopes[POSITION_STATE, VELOCITY_STATE]
    # a wrong pressure moves the position, too, and is corrected as if by a velocity
    moves = slopes[np.ix_(states, states)] - np.outer(by_position, slopes[POSITION_STATE, states])
    noise, uncertain = Sensors.of_size(size).pressure_noise, PRESSURE_UNCERTAINTY * size.pressure
    into = slopes[np.ix_(states, [one.chamber for one in sensors])]
    # units of 1 Pa and, of rates, 1 Pa a sample
    units = np.tile([1.0, 1.0, 1.0 / SAMPLE_PERIOD], count)
    moves, into = moves * units / units[:, None], into / units[:, None]
    shown = np.zeros((count, 3 * count))
    shown[np.arange(count), 3 * np.arange(count) + 1] = 1.0
    spread = uncertain**2 * into @ into.T + 1e-6 * noise**2 * np.eye(3 * count)
    known = np.asarray(solve_discrete_are(moves.T, shown.T, spread, noise**2 * np.eye(count)))
    gains = known @ shown.T @ np.linalg.inv(shown @ known @ shown.T + noise**2 * np.eye(count))
    return np.vstack(((units[:, None] * gains).T, by_position))
