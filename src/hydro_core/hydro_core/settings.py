# SPDX-License-Identifier: Apache-2.0
"""Settings: frozen dataclasses whose annotations give each field's unit, range and meaning.

::

    @dataclass(frozen=True, kw_only=True)
    class PortSettings:
        path: Annotated[str, described("Device, or link to one")] = "/dev/ttyUSB0"
        silence_max: Annotated[float, quantity("s", 0.1, 60.0, "Longest time without a byte")] = 1.0
        parity: Literal["none", "even"] = "none"

Checks, YAML files, options, ROS parameters, help texts and reference pages are derived from them. msgspec converts and
checks (docs/decisions/0062-settings-by-msgspec.md). Missing and unknown YAML keys are errors.
"""

from __future__ import annotations

import argparse
import dataclasses
import types
import typing
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import inf, isfinite
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import yaml

from hydro_core.errors import UserError

T = TypeVar("T")


class SettingsError(UserError, ValueError):
    """An invalid setting; the message is one sentence that names it and the allowed range."""


def quantity(unit: str, low: float, high: float, meaning: str | None = None) -> msgspec.Meta:
    """Return the annotation of a numeric field: unit ("-": dimensionless), closed range [low, high] and meaning."""
    # msgspec checks integers against integer limits only.
    ge, le = (int(limit) if float(limit).is_integer() else limit for limit in (low, high))
    return msgspec.Meta(ge=ge, le=le, description=meaning, extra={"unit": unit})


def described(meaning: str) -> msgspec.Meta:
    """Return the annotation of any other field: its meaning."""
    return msgspec.Meta(description=meaning)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setting:
    """Declaration of one settings field."""

    hint: Any
    """Type of the field, with annotations."""
    kind: Any
    """Type without annotations and None; for a tuple, that of its entries."""
    unit: str
    low: float
    high: float
    meaning: str
    required: bool

    @property
    def choices(self) -> tuple[str, ...]:
        """Allowed values of a field of type Literal."""
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is Literal else ()

    @property
    def range(self) -> str:
        """Range as text, `low to high`; empty if there is none."""
        return f"{self.low:.12g} to {self.high:.12g}" if isfinite(self.low) else ""

    @property
    def text(self) -> str:
        """Meaning, unit and range, as shown in help texts and ROS."""
        limits = ", ".join(filter(None, (self.unit.strip("-"), self.range)))
        return f"{self.meaning} [{limits}]".strip() if limits else self.meaning

    @property
    def allowed(self) -> str:
        """Allowed values, for messages: `a number within [0, 1] N`."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        several = typing.get_origin(self.hint) is tuple
        nouns = {float: "numbers" if several else "a number", int: "a whole number", str: "text", bool: "true or false"}
        limits = f" within [{self.low:g}, {self.high:g}] {self.unit.strip('-')}" if self.range else ""
        return f"{nouns.get(self.kind, 'a mapping')}{limits}".strip()


_SETTINGS_BY_CLASS: dict[type[Any], dict[str, Setting]] = {}


def describe(settings: type[Any]) -> dict[str, Setting]:
    """Return the declarations of all fields of a settings dataclass, in order."""
    if settings in _SETTINGS_BY_CLASS:
        return _SETTINGS_BY_CLASS[settings]
    hints = typing.get_type_hints(settings, include_extras=True)
    known = _SETTINGS_BY_CLASS[settings] = {}
    for field in dataclasses.fields(settings):
        kind, meta = _unwrapped(hints[field.name])
        known[field.name] = Setting(
            hint=hints[field.name],
            kind=kind,
            unit=(meta.extra or {}).get("unit", "-"),
            low=-inf if meta.ge is None else meta.ge,
            high=inf if meta.le is None else meta.le,
            meaning=meta.description or "",
            required=field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING,
        )
    return known


def _unwrapped(hint: Any) -> tuple[Any, msgspec.Meta]:
    """Return the type inside Annotated, `| None` and tuple, and the first annotation found on the way."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        kind, _ = _unwrapped(arguments[0])
        return kind, arguments[1]
    if origin in (types.UnionType, typing.Union):
        return _unwrapped(next(argument for argument in arguments if argument is not type(None)))
    return _unwrapped(arguments[0]) if origin is tuple else (hint, msgspec.Meta())


def check(settings: Any) -> None:
    """Raise SettingsError for the first value of a settings dataclass that violates its declaration."""
    for name, setting in describe(type(settings)).items():
        value = getattr(settings, name)
        sound = type(value) is float is setting.kind and setting.low <= value <= setting.high  # most are, at once
        if not sound and (isfinite(setting.low) or setting.choices):
            convert(setting, value.item() if hasattr(value, "item") else value, name, strict=True)


def convert(setting: Setting, value: Any, where: str, *, strict: bool = False) -> Any:
    """Return `value` in the declared type; unless `strict`, numbers may be given as text (as 1e9 is in YAML 1.1).

    Raises SettingsError: the value violates the declaration; the sentence begins with `where`.
    """
    try:
        return msgspec.convert(value, setting.hint, strict=strict)
    except msgspec.ValidationError:
        raise SettingsError(f"{where} must be {setting.allowed}, not {value!r}") from None


def add_options(parser: argparse.ArgumentParser, defaults: Any, names: Sequence[str]) -> None:
    """Add a command's option for each of these fields of a settings dataclass; `defaults`: an instance."""
    for name in names:
        setting, default = describe(type(defaults))[name], getattr(defaults, name)
        words = {float: "NUMBER", int: "N", str: "TEXT"}
        how: dict[str, Any] = {"type": setting.kind, "metavar": words.get(setting.kind)}
        if setting.kind is bool:
            how = {"action": "store_true"}
        elif setting.choices:
            how = {"choices": setting.choices}
        text = f"{setting.text}; default %(default)s" if default else setting.text
        parser.add_argument("--" + name.replace("_", "-"), default=default, help=text, **how)


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Return the mapping in a YAML file. Raises SettingsError if the file cannot be read or does not hold a mapping."""
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SettingsError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    data = {} if data is None else data
    if not isinstance(data, dict):
        raise SettingsError(f"{path} must hold a mapping, not a {type(data).__name__}")
    return data


def from_mapping(cls: type[T], data: object, where: str) -> T:
    """Build a settings dataclass from plain YAML data.

    `cls`: a settings dataclass. Its fields may be such dataclasses, and tuples of them. `data`: mapping from field name
    to value. A tuple of dataclasses takes one mapping or a list of them. `where`: path to `data` inside its file, for
    messages. Raises SettingsError: on an unknown or missing key, a wrong type, or a value outside its range.
    """
    if not isinstance(data, Mapping):
        raise SettingsError(f"{where} must be a mapping of settings, not {data!r}")
    known = describe(cls)
    for key in data:
        if key not in known:
            raise SettingsError(unknown_key(str(key), list(known), where))
    for name, setting in known.items():
        if setting.required and name not in data:
            raise SettingsError(f"{where} lacks {name} [{setting.unit}]")
    values: dict[str, Any] = {}
    for key, value in data.items():
        setting, place = known[key], f"{where}.{key}"
        nested = dataclasses.is_dataclass(setting.kind)
        if nested and typing.get_origin(setting.hint) is tuple:
            items = value if isinstance(value, list) else [] if value is None else [value]
            values[key] = tuple(from_mapping(setting.kind, item, place) for item in items)
        elif nested and value is not None:
            values[key] = from_mapping(setting.kind, value, place)
        else:
            values[key] = convert(setting, value, place)
    return cls(**values)


def unknown_key(key: str, known: list[str], where: str) -> str:
    """Return the error message for an unknown key, with the nearest known key, or all of them."""
    near = get_close_matches(key, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    return f"{where}.{key} is not a known setting; {hint}"
