# SPDX-License-Identifier: Apache-2.0
"""Settings as frozen dataclasses whose fields carry unit and range, and their YAML form with strict keys."""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

T = TypeVar("T")


class ConfigError(ValueError):
    """A configuration file that cannot be used; the message is one sentence for its author."""


def quantity(
    default: Any = dataclasses.MISSING, *, unit: str = "-", low: float = -math.inf, high: float = math.inf
) -> Any:
    """Field of a settings dataclass: a number with its unit and its closed range."""
    return dataclasses.field(default=default, metadata={"unit": unit, "low": low, "high": high})


def choice(default: Any, *options: str) -> Any:
    """Field of a settings dataclass: one word out of `options`."""
    return dataclasses.field(default=default, metadata={"options": options})


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Mapping that a YAML file holds.

    Raises
    ------
    ConfigError
        If the file cannot be read or does not hold a mapping.
    """
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} cannot be read: it is no text in UTF-8") from error
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path} must hold a mapping, not a {type(data).__name__}")
    return data


def from_mapping(cls: type[T], data: object, where: str) -> T:
    """Build the settings dataclass `cls` from plain YAML data.

    Parameters
    ----------
    cls
        A frozen dataclass whose fields were made by `quantity`, `choice`, or are dataclasses, or tuples of dataclasses.
    data
        Mapping from field name to value. A tuple field takes one mapping or a list of them.
    where
        Path to `data` inside its file, for messages.

    Raises
    ------
    ConfigError
        On an unknown or missing key, a wrong type, or a value outside its range.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{where} must be a mapping of settings, not {data!r}")
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(cls)
    for key in data:
        if key not in fields:
            raise ConfigError(unknown_key(str(key), list(fields), where))
    for name, field in fields.items():
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if required and name not in data:
            raise ConfigError(f"{where} lacks {name} [{field.metadata.get('unit', '-')}]")
    return cls(**{key: _value(hints[key], fields[key], value, f"{where}.{key}") for key, value in data.items()})


def unknown_key(key: str, known: list[str], where: str) -> str:
    """Sentence for a key that is not known, with the nearest one that is."""
    near = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    return f"{where}.{key} is not a known setting; {hint}"


def _value(hint: Any, field: dataclasses.Field[Any], value: object, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in arguments:
            return None
        hint = next(argument for argument in arguments if argument is not type(None))
    if typing.get_origin(hint) is tuple:
        items = [] if value is None else value if isinstance(value, list) else [value]
        return tuple(from_mapping(typing.get_args(hint)[0], item, where) for item in items)
    if dataclasses.is_dataclass(hint):
        return from_mapping(typing.cast("type[Any]", hint), value, where)
    if hint is str:
        return _word(value, field.metadata.get("options", ()), where)
    return _number(value, hint, field.metadata, where)


def _word(value: object, options: tuple[str, ...], where: str) -> str:
    if not isinstance(value, str) or (options and value not in options):
        raise ConfigError(f"{where} must be one of {', '.join(options)}, not {value!r}")
    return value


def _number(value: object, kind: Any, metadata: Mapping[str, Any], where: str) -> float | int:
    unit = metadata.get("unit", "-")
    try:
        number = float(value)  # type: ignore[arg-type]  # PyYAML reads 1e9 as a string
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise ConfigError(f"{where} must be a number in {unit}, not {value!r}")
    low, high = metadata.get("low", -math.inf), metadata.get("high", math.inf)
    if not low <= number <= high:
        raise ConfigError(f"{where} must be within [{low:g}, {high:g}] {unit}, not {number:g}")
    if kind is int:
        if number != int(number):
            raise ConfigError(f"{where} must be a whole number, not {number:g}")
        return int(number)
    return number


def to_mapping(settings: Any) -> dict[str, Any]:
    """Plain data of a settings dataclass, ready for YAML; effects that are off are left out."""
    result: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, tuple):
            items = [to_mapping(item) for item in value]
            if items:
                result[field.name] = items[0] if len(items) == 1 else items
        elif dataclasses.is_dataclass(value):
            result[field.name] = to_mapping(value)
        elif value is not None or field.default is not None:
            result[field.name] = value
    return result
