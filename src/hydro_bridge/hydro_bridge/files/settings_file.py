# SPDX-License-Identifier: Apache-2.0
"""Settings dataclasses as YAML, with strict keys: missing and unknown ones are reported, with the nearest known key."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import yaml

from hydro_bridge.settings import Setting, SettingsError, converted, describe

T = TypeVar("T")


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Return the mapping in a YAML file. Raises SettingsError if the file cannot be read or does not hold a mapping."""
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path} cannot be read: it is not UTF-8 text") from error
    except (OSError, yaml.YAMLError) as error:
        raise SettingsError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if data is None:
        return {}
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
    return cls(**{key: _value(known[key], value, f"{where}.{key}") for key, value in data.items()})


def unknown_key(key: str, known: list[str], where: str) -> str:
    """Return the sentence for an unknown key, with the nearest known one."""
    near = get_close_matches(key, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    return f"{where}.{key} is not a known setting; {hint}"


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return a settings dataclass as plain data for YAML, without None and empty entries."""
    result: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, tuple) and all(map(dataclasses.is_dataclass, value)):
            items = [to_mapping(item) for item in value]
            if items or field.default:  # an empty entry equals the default
                result[field.name] = items[0] if len(items) == 1 else items
        elif dataclasses.is_dataclass(value):
            result[field.name] = to_mapping(value)
        elif value is not None or field.default is not None:
            result[field.name] = value
    return result


def _value(setting: Setting, value: Any, where: str) -> Any:
    kind, nested = setting.kind, dataclasses.is_dataclass(setting.kind)
    if nested and typing.get_origin(setting.hint) is tuple:
        items = [] if value is None else value if isinstance(value, list) else [value]
        return tuple(from_mapping(kind, item, where) for item in items)
    if nested and not (value is None and type(None) in typing.get_args(setting.hint)):
        return from_mapping(kind, value, where)
    return None if nested else converted(setting, value, where)
