# SPDX-License-Identifier: Apache-2.0
"""Parameters of a bench file's effects for the certificate: hidden states, load, sensors, null shifts."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, pi
from types import SimpleNamespace
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model.parts import NONE
from hydro_sim.model import rates
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import TEXTBOOK
from hydro_sim.model.effects import catalogue
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.equations import LOAD_CELL_DAMPING
from hydro_sim.model.sensors import RAW_FIELDS

Name = tuple[str, int, str]
"""Of a hidden state: its effect's label, which one of several with that label, the state."""

CELL = "sensor_lag sensor=load_force"
_LOAD, _LOAD_RATE = 4, 5  # of the textbook's states: what an amplifier of the bench itself shows


def hidden_state_numbers(bench: Bench) -> dict[Name, int]:
    """Numbers of a bench's hidden states in its model."""
    seen: dict[str, int] = {}
    places: dict[Name, int] = {}
    for effect in bench.terms:
        label = catalogue.label(effect)
        seen[label] = seen.get(label, -1) + 1
        for state in catalogue.kind_of(effect)[0].effect.states:
            places[label, seen[label], state.name] = TEXTBOOK + len(places)
    return places


def state_number(numbers: Mapping[Name, int], label: str, state: str) -> int:
    """Number of the first state of this name of an effect whose label begins so; `NONE` where there is none."""
    return next((at for (has, _, name), at in numbers.items() if has.startswith(label) and name == state), NONE)


def cell_states(bench: Bench, numbers: Mapping[Name, int]) -> tuple[int, int]:
    """Numbers of the states that the load cell shows: force and its rate, `NONE` if the cell is ideal."""
    if (force := state_number(numbers, CELL, "signal")) != NONE:
        return force, state_number(numbers, CELL, "rate")
    return _LOAD, _LOAD_RATE if float(bench.constants()["load_cell_omega"][0]) > 0.0 else NONE


def _made(numbers: Any, effect: Mapping[str, Any], velocity: float = 0.0) -> Effect:
    """An effect with its numbers, for terms that need no state but the velocity [m/s]."""
    kind, values = catalogue.kind_of(effect)
    made = kind.make()
    made.at = SimpleNamespace(numbers=numbers, velocity=velocity)
    for parameter, value in zip(kind.parameters, values, strict=True):
        setattr(made, parameter.name, value)
    return made


def load_curve(record: Any, effects: list[Mapping[str, Any]], positions: FloatArray) -> FloatArray:
    """f_l [N] at positions [m], without backlash."""
    numbers = SimpleNamespace(**{name: float(record[name]) for name in record.dtype.names})
    force = rates.load(numbers, [_made(numbers, effect) for effect in effects], positions)
    return np.asarray(force, np.float64)


def follows_velocity(bench: Bench, effect: Mapping[str, Any]) -> bool:
    """Whether a load's effect, one that has no states, hangs on the velocity."""
    positions = np.linspace(0.0, bench.stroke, 9)
    still, out, back = (
        _made(bench, effect, velocity).load(0.0 * positions, positions) for velocity in (0.0, 0.1, -0.1)
    )
    return not (np.array_equal(still, out) and np.array_equal(still, back))


def sensor_scales(truth: Bench) -> tuple[FloatArray, FloatArray]:
    """Gain and bias of the five readings."""
    made = [_made(None, effect) for effect in truth.effects]
    ends = np.array([[0.0] * len(RAW_FIELDS), [1.0] * len(RAW_FIELDS)])
    for effect in made:
        ends = np.array([[effect.show(name, z) for name, z in zip(RAW_FIELDS, row, strict=True)] for row in ends])
    return ends[1] - ends[0], ends[0]


def null_shifts(truth: Bench) -> tuple[float, float]:
    """Null shifts [A] before and behind the valve's lag, in the order of the bench file."""
    shifts, behind = [0.0, 0.0], False
    for effect in truth.effects:
        behind = behind or effect["id"] == "valve_lag"
        if effect["id"] == "valve_offset":
            shifts[int(behind)] += catalogue.kind_of(effect)[1][0]
    return shifts[0], shifts[1]


def cell_dynamics(truth: Bench) -> tuple[float, float]:
    """2 d/w [s] and 1/w^2 [s^2] of the load cell's amplifier."""
    for effect in truth.effects:
        if catalogue.label(effect) == CELL:
            bandwidth, damping = catalogue.kind_of(effect)[1]
            return 2.0 * damping / (2.0 * pi * bandwidth), (2.0 * pi * bandwidth) ** -2
    omega = float(truth.constants()["load_cell_omega"][0]) or inf
    return 2.0 * LOAD_CELL_DAMPING / omega, 1.0 / omega**2


def valve_age(truth: Bench) -> float:
    """Time [s] by which the valve's lag puts its spool behind a slow command: 2 d/w, of the first order 1/w."""
    for effect in truth.effects:
        if effect["id"] == "valve_lag":
            bandwidth, *damping = catalogue.kind_of(effect)[1]
            return (2.0 * damping[0] if damping else 1.0) / (2.0 * pi * bandwidth)
    return 0.0
