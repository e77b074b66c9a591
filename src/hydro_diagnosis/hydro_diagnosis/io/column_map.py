# SPDX-License-Identifier: Apache-2.0
"""Column map: assigns columns of a file to BenchState fields, with unit, scale, offset and delay.

::

    time=t,piston_position=pos[mm],hydraulic_force=vir*gtau,pressure_a=pa[bar]+1,load_force=0

On the left `time` or a BenchState field; on the right a column, its unit in brackets if it is neither SI nor the one
that the file states, then `*`, `/`, `+` or `-` with a number or the name of a single number in the file, taken from
left to right and in that unit, then `@` and the time by which the column is late (`fl@20ms`). A number alone is a
constant, `none` leaves a field out. A YAML file holds the same, one line each, or the words column, unit, scale,
offset, delay.

A map without `time` corrects what there is: all columns that carry a field's own name are taken besides, and the times
that the file states.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.signals import STATE_FIELDS
from hydro_diagnosis.io.column_source import Source, source_of
from hydro_diagnosis.recording import InputError

TARGETS = ("time", *STATE_FIELDS)
"""Targets of a column."""


@dataclass(frozen=True)
class ColumnMap:
    """Sources by `time` and BenchState field name."""

    sources: Mapping[str, Source]
    absent: frozenset[str] = frozenset()
    """Fields that are left out though the file has columns of their names."""

    def __str__(self) -> str:
        """Text as it is given to `--columns`."""
        left_out = [f"{field}=none" for field in sorted(self.absent)]
        return ",".join([*(f"{field}={source}" for field, source in self.sources.items()), *left_out])

    def completed(self, names: Iterable[str]) -> ColumnMap:
        """Return the map with the columns among `names` that carry a field's own name, unless it maps the time."""
        if "time" in self.sources:
            return self
        besides = {name: Source(name) for name in names if name in TARGETS and name not in self.absent}
        return ColumnMap({**besides, **self.sources}, self.absent)

    def corrections(self) -> ColumnMap:
        """Return only what differs from columns that carry the fields' own names."""
        return ColumnMap({name: one for name, one in self.sources.items() if one != Source(name)}, self.absent)

    def changed(self, field: str, source: Source | None) -> ColumnMap:
        """Return the map with another source for a field, or without the field."""
        others = {name: one for name, one in self.sources.items() if name != field or source is not None}
        if source is None:
            return ColumnMap(others, self.absent | {field})
        return ColumnMap({**others, field: source}, self.absent - {field})

    @classmethod
    def load(cls, given: str | Path | Mapping[str, Any] | ColumnMap | None) -> ColumnMap | None:
        """Load a map from `FIELD=SOURCE,...`, the path of a YAML file, or a mapping; None stays None.

        Raises
        ------
        InputError
            In one sentence that names what cannot be read, and for a field the names that there are.
        """
        if given is None or isinstance(given, ColumnMap):
            return given
        if isinstance(given, Mapping):
            absent = frozenset(_target(str(key)) for key, value in given.items() if value is None or value == "none")
            there = {str(key): value for key, value in given.items() if str(key) not in absent}
            return cls({_target(key): source_of(key, value) for key, value in there.items()}, absent)
        if isinstance(given, Path) or (str(given).endswith((".yaml", ".yml")) and "=" not in str(given)):
            return cls.load(_from_yaml(Path(given)))
        pairs = [part.partition("=") for part in _parts(str(given))]
        for left, equals, _ in pairs:
            if not equals:
                raise InputError(f"columns: {left.strip()!r} is not FIELD=COLUMN, for instance piston_position=pos[mm]")
        return cls.load({left.strip(): right.strip() for left, _, right in pairs})


def _target(name: str) -> str:
    if name not in TARGETS:
        close = difflib.get_close_matches(name, TARGETS, 1)
        hint = f", did you mean {close[0]!r}?" if close else f": there are {', '.join(TARGETS)}"
        raise InputError(f"columns: {name!r} is no field of a recording{hint}")
    return name


def _parts(text: str) -> list[str]:
    """Split at commas outside of quotes."""
    parts = re.findall(r"""(?:[^,'"]|'[^']*'|"[^"]*")+""", text)
    return [part for part in parts if part.strip()]


def _from_yaml(path: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: a column map is a mapping of fields to columns")
    return content
