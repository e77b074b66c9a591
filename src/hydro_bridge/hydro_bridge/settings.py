# SPDX-License-Identifier: Apache-2.0
"""What a settings dataclass says about its fields, read from where it says it: the sentence below each field.

The sentence gives the unit first and may give a range as ``[low, high]``. Parameters, command lines and checks all
take it from here, so that it is written once.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

_RANGE = re.compile(r"\[\s*(-?[\d.]+(?:e[+-]?\d+)?)\s*,\s*(-?[\d.]+(?:e[+-]?\d+)?)\s*\]", re.IGNORECASE)


class SettingsError(ValueError):
    """A setting is out of its range; the message says which and what is allowed."""


@dataclass(frozen=True, kw_only=True)
class FieldDoc:
    """Documentation of one field."""

    text: str
    low: float | None
    high: float | None


_KNOWN: dict[type[Any], dict[str, FieldDoc]] = {}


def describe(settings: type[Any]) -> dict[str, FieldDoc]:
    """Documentation of each field of a settings dataclass, in order; empty text where there is none."""
    if settings not in _KNOWN:
        _KNOWN[settings] = _describe(settings)
    return _KNOWN[settings]


def _describe(settings: type[Any]) -> dict[str, FieldDoc]:
    tree = ast.parse(textwrap.dedent(inspect.getsource(settings)))
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    texts: dict[str, str] = {}
    for node, below in pairwise(body):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and isinstance(below, ast.Expr):
            value = below.value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                texts[node.target.id] = inspect.cleandoc(value.value)
    return {field.name: _doc(texts.get(field.name, "")) for field in fields(settings)}


def check(settings: Any) -> None:
    """Raise SettingsError for the first field that is outside the range which its sentence gives."""
    for name, doc in describe(type(settings)).items():
        value = getattr(settings, name)
        if doc.low is None or doc.high is None or isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        if not doc.low <= value <= doc.high:
            raise SettingsError(f"{name} is {value:g}, allowed is [{doc.low:g}, {doc.high:g}]: {doc.text}")


def _doc(text: str) -> FieldDoc:
    found = _RANGE.search(text)
    return FieldDoc(
        text=text,
        low=float(found[1]) if found else None,
        high=float(found[2]) if found else None,
    )
