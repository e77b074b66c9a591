# SPDX-License-Identifier: Apache-2.0
"""From the effects of a bench file to what compiled code reads: numbers of the bench put right, the rest a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.model.effects import lags, valve
from hydro_sim.model.effects.catalogue import form_of, label
from hydro_sim.model.effects.forms import Form
from hydro_sim.model.effects.record import CAPACITY, COMMAND, EFFECTS_DTYPE, HISTORY, HOOKS, LAG, SUBSTEPS

Entry = tuple[Form, tuple[float, ...]]


def check(effects: Sequence[Mapping[str, Any]]) -> None:
    """Refuse what cannot be simulated.

    Raises
    ------
    ValueError
        In one sentence: an effect that is unknown, lacks a parameter, or is given more often than it can be.
    """
    entries = [form_of(effect) for effect in effects]
    names = [label(effect) for effect in effects]
    for single in ("supply_droop", "friction_presliding", "backlash form=play"):
        if names.count(single) > 1:
            raise ValueError(f"effect {single} is given twice")
    if len(entries) > CAPACITY:
        raise ValueError(f"{len(entries)} effects are more than the {CAPACITY} that are simulated at once")
    if _delay(entries) > HISTORY - 2:
        raise ValueError(f"dead times add up to more than {HISTORY - 2} ms")


Numbers = dict[str, float | None]


def corrected(
    numbers: Numbers, limits: Mapping[str, tuple[float, float]], effects: Sequence[Mapping[str, Any]]
) -> Numbers:
    """A bench's numbers with those effects applied that say a number is wrong, one after the other, within `limits`."""
    result = dict(numbers)
    for effect in effects:
        form, values = form_of(effect)
        changes = _changes(result, effect, values) if form.hook is None or form.hook == LAG else {}
        result |= {name: _inside(value, *limits[name]) for name, value in changes.items()}
    return result


def _changes(numbers: Mapping[str, Any], effect: Mapping[str, Any], values: tuple[float, ...]) -> Numbers:
    """Numbers of the bench that an effect replaces."""
    value = values[0]
    match effect["id"]:
        case "friction_viscous":
            return {"viscous_friction": numbers["viscous_friction"] + value}
        case "moving_mass":
            return {"moving_mass": numbers["moving_mass"] + value}
        case "spring_rest":
            return {"spring_rest_position": value}
        case "tank_pressure":
            return {"tank_pressure": value}
        case "dead_volume":
            name = f"dead_volume_{effect['chamber']}"
            return {name: numbers[name] * value}
        case "sensor_lag":  # takes the place of the amplifier that the bench file states
            return {"load_cell_bandwidth": None} if effect["sensor"] == "load_force" else {}
        case "piston_area" | "area_ratio" | "supply_pressure" | "spring_stiffness" as name:
            return {name: numbers[name] * value}
    return {}


def _inside(value: float | None, low: float, high: float) -> float | None:
    return value if value is None else min(max(value, low), high)


def program(effects: Sequence[Mapping[str, Any]]) -> npt.NDArray[np.void]:
    """One record of `EFFECTS_DTYPE`, shape (1,), of a bench's effects."""
    record = np.zeros(1, EFFECTS_DTYPE)
    entries = [entry for entry in map(form_of, effects) if entry[0].hook is not None]
    record["active"], record["delay"] = bool(entries), _delay(entries)
    count = 0
    for hook in range(HOOKS):
        record["first"][0, hook] = count
        for form, values in sorted((entry for entry in entries if entry[0].hook == hook), key=_stage):
            if not _is_delay(form):
                numbers = _numbers(form, values, SAMPLE_PERIOD / SUBSTEPS)
                record["kind"][0, count], record["value"][0, count, : len(numbers)] = form.kind, numbers
                count += 1
    record["first"][0, HOOKS] = count
    return record


def _is_delay(form: Form) -> bool:
    return form.hook == COMMAND and form.kind == valve.DELAY


def _delay(entries: Sequence[Entry]) -> float:
    """Dead times together, in samples."""
    return sum(values[0] for form, values in entries if _is_delay(form)) / SAMPLE_PERIOD


def _stage(entry: Entry) -> int:
    """Order within a hook: the spool moves, then its edges open; else as in the file."""
    form, _ = entry
    return int(form.hook == COMMAND and form.kind in (valve.OVERLAP, valve.OVERLAP_SOFT))


def _numbers(form: Form, values: tuple[float, ...], step: float) -> tuple[float, ...]:
    """What an entry's function reads."""
    if form.hook == COMMAND and form.kind == valve.OVERLAP:
        return values[0], values[-1]
    if form.hook == COMMAND and form.kind == valve.FIRST_ORDER:
        return lags.first_order(values[0], step)
    if form.hook == COMMAND and form.kind == valve.SECOND_ORDER:
        return lags.held(values[0], values[1], step)
    if form.hook == LAG:
        return (*lags.straight(values[0], values[1], step), *form.constants)
    return (*values, *form.constants)
