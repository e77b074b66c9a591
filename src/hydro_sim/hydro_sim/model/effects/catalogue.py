# SPDX-License-Identifier: Apache-2.0
"""Catalogue of the effects of bench files, by id and options.

An entry of `effects` in bench.yaml is `{id: ..., <option>: ..., parameters: {name: number}}`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from itertools import product
from math import isfinite
from types import SimpleNamespace
from typing import Any

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.model.effects import closure, friction, motion, oil, parameter_corrections, sensing, valve
from hydro_sim.model.effects.base import Effect, Parameter
from hydro_sim.model.effects.closure import Closure

EFFECTS_MAX = 24
"""Largest number of effects of a bench."""
CLOSURES_MAX = 6
"""Largest number of closures of a bench."""
DELAY_MAX = 62e-3
"""Largest sum [s] of dead times."""


@dataclass(frozen=True)
class Kind:
    """Class of effects with its options."""

    effect: type[Effect]
    chosen: tuple[tuple[str, str], ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the effect."""
        return self.effect.parameters

    def make(self) -> Effect:
        """Create an instance for the assembly of a model."""
        return self.effect(**dict(self.chosen))

    def bind(self, values: Mapping[str, Any], **context: Any) -> Any:
        """Create an instance for calls of its terms with numbers: its parameters' values, and fields of `at`."""
        made = object.__new__(self.effect)
        made.__dict__ = {**self._unbound, **values, "next": {}, "at": SimpleNamespace(**context)}
        return made

    @cached_property
    def _unbound(self) -> dict[str, Any]:
        return vars(self.make())


def label(effect: Mapping[str, Any]) -> str:
    """Return id and options of an entry as text."""
    options = sorted((str(key), str(value)) for key, value in effect.items() if key not in ("id", "parameters"))
    return " ".join([str(effect["id"]), *(f"{key}={value}" for key, value in options)])


def _kinds(effects: Sequence[type[Effect]]) -> dict[str, Kind]:
    kinds = {}
    for effect in effects:
        for values in product(*effect.options.values()):
            chosen = tuple(zip(effect.options, values, strict=True))
            kinds[label({"id": effect.id, **dict(chosen)})] = Kind(effect, chosen)
    return kinds


_TABLE: tuple[type[Effect], ...] = (
    *valve.EFFECTS, *oil.EFFECTS, *friction.EFFECTS, *motion.EFFECTS, *sensing.EFFECTS,
    *parameter_corrections.EFFECTS,
)  # fmt: skip
CATALOGUE: dict[str, Kind] = _kinds(_TABLE)
"""Effects by id and options, as `label` writes them."""
KINDS: dict[str, Kind] = CATALOGUE | _kinds(closure.EFFECTS)
"""Effects and closures."""


def parse_entry(effect: Mapping[str, Any]) -> tuple[Kind, tuple[float, ...]]:
    """Return kind and parameter values of a bench file's entry.

    Raises ValueError: in one sentence, if the effect is unknown or a parameter is missing, too many, or not a number in
    range.
    """
    name, parameters = label(effect), effect.get("parameters") or {}
    if name not in KINDS:
        known = get_close_matches(name, KINDS, 3)
        raise ValueError(f"effect {name!r} is not known" + (f"; there is {', '.join(known)}" if known else ""))
    if not isinstance(parameters, Mapping):
        raise ValueError(f"effect {name}: 'parameters' is a mapping of names to numbers")
    kind, values = KINDS[name], list[float]()
    unknown = [key for key in parameters if key not in {one.name for one in kind.parameters}]
    if unknown:
        raise ValueError(f"effect {name} has no parameter {unknown[0]!r}")
    for one in kind.parameters:
        if one.name not in parameters:
            raise ValueError(f"effect {name} lacks its parameter {one.name} [{one.unit}]")
        try:
            value = float(parameters[one.name])  # PyYAML reads 1e9 as a text
        except (TypeError, ValueError):
            value = float("nan")
        if not (isfinite(value) and one.low <= value <= one.high):
            wanted = f"a number in [{one.low:g}, {one.high:g}] {one.unit}"
            raise ValueError(f"effect {name}: {one.name} = {parameters[one.name]!r} is not {wanted}")
        values.append(value)
    return kind, tuple(values)


def total_delay(effects: Sequence[Mapping[str, Any]]) -> float:
    """Return the sum of all dead times [s]."""
    return sum(parse_entry(effect)[1][0] for effect in effects if effect["id"] == valve.TransportDelay.id)


def check_effects(effects: Sequence[Mapping[str, Any]]) -> None:
    """Raise ValueError in one sentence for an effect that is unknown, lacks a parameter, or is given too often."""
    entries = [(label(effect), *parse_entry(effect)) for effect in effects]
    closures = sum(kind.effect.id == Closure.id for _, kind, _ in entries)
    for count, most, what in ((closures, CLOSURES_MAX, "closures"), (len(entries), EFFECTS_MAX, "effects")):
        if count > most:
            raise ValueError(f"{count} {what} are more than the {most} that are simulated at once")
    for name, kind, values in entries:
        given = dict(zip((one.name for one in kind.parameters), values, strict=True))
        if kind.effect.id == Closure.id and "low" in given and not given["low"] < given["high"]:
            raise ValueError(f"effect {name}: low must be below high")
    names = [name for name, _, _ in entries]
    for name, kind, _ in entries:
        if kind.effect.single and names.count(name) > 1:
            raise ValueError(f"effect {name} is given twice")
    if total_delay(effects) > DELAY_MAX:
        raise ValueError(f"dead times add up to more than {DELAY_MAX / SAMPLE_PERIOD:g} ms")
