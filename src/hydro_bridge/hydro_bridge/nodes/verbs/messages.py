# SPDX-License-Identifier: Apache-2.0
"""Message classes by type name, and conversion between messages and plain types for YAML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

import yaml

from hydro_bridge.cli.console import UserError

_ELEMENT = re.compile(r"(?:sequence<)?(\w+/\w+)(?:\[\d+\]|(?:, \d+)?>)?")
_LONG = (bytes, bytearray, str)


def interface(name: str, kind: str) -> type[Any]:
    """Return the class of a type such as `std_srvs/srv/SetBool`; the name may omit `kind` (msg or srv).

    Raises UserError: there is no type of that name.
    """
    package, _, rest = name.partition("/")
    last = rest.removeprefix(f"{kind}/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.{kind}"), last)
    except (ImportError, AttributeError, TypeError, ValueError):
        raise UserError(f"{name} is not a {kind} type known here: give package/{kind}/Name") from None
    return found


def plain(value: Any) -> Any:
    """Convert a message, or a value in one, to YAML types."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "little") if len(value) == 1 else list(value)
    if isinstance(value, Iterable) and not isinstance(value, _LONG):
        return [plain(entry) for entry in value]
    return value.item() if hasattr(value, "item") else value


def as_yaml(value: Any) -> str:
    """Return a message or plain value as YAML, one field per line."""
    text = yaml.safe_dump(plain(value), sort_keys=False, allow_unicode=True, width=float("inf"))
    return text.removesuffix("...\n")


def parsed(text: str) -> dict[str, Any]:
    """Parse a mapping written as YAML, `{}` for none; raises UserError."""
    try:
        values = yaml.safe_load(text) if text.strip() else {}
    except yaml.YAMLError as error:
        raise UserError(f"{text!r} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(values, dict):
        raise UserError(f"{text!r}: give fields as YAML, such as '{{data: true}}'")
    return values


def fill(message: Any, values: Mapping[str, Any]) -> None:
    """Set a message's fields; raises UserError for an unknown field or a value of the wrong type.

    The message must be created with `check_fields=True`: otherwise ROS accepts any value, and fails on sending.
    """
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in kinds:
            raise UserError(f"{type(message).__name__} has no field {name}; it has: {', '.join(kinds) or 'none'}")
        try:
            setattr(message, name, _converted(getattr(message, name), value, kinds[name]))
        except (AssertionError, TypeError, ValueError, OverflowError):
            raise UserError(f"{name}: {value!r} is no {kinds[name]}") from None


def _converted(before: Any, value: Any, kind: str) -> Any:
    """Convert `value` to the type of a field; messages, or lists of them, are made from mappings."""
    named = _ELEMENT.fullmatch(kind)
    if isinstance(before, float):
        return float(value)
    if named is None:
        return value
    if not isinstance(value, Sequence):
        return _made(named[1], value)
    return [_made(named[1], entry) for entry in value]


def _made(type_name: str, values: Mapping[str, Any]) -> Any:
    if not isinstance(values, Mapping):
        raise TypeError
    message = interface(type_name, "msg")(check_fields=True)
    fill(message, values)
    return message
