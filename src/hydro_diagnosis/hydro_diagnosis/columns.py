# SPDX-License-Identifier: Apache-2.0
"""A column map: which column of somebody's file is which BenchState field, in which unit, and turned by what.

::

    time=t,piston_position=pos[mm],hydraulic_force=vir*gtau,pressure_a=pa[bar]+1,load_force=0

On the left `time` or a BenchState field; on the right a column, its unit in brackets if it is not SI, then `*`, `/`,
`+` or `-` with a number or the name of a single number in the file, taken from left to right and in that unit. A number
alone is a constant. A YAML file holds the same, one line each, or the words column, unit, scale, offset.
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
from hydro_diagnosis.column_source import Source, source_of
from hydro_diagnosis.recording import InputError

TARGETS = ("time", *STATE_FIELDS)
"""What a column can become."""


@dataclass(frozen=True)
class ColumnMap:
    """Sources by `time` and BenchState field name."""

    sources: Mapping[str, Source]

    @classmethod
    def load(cls, given: str | Path | Mapping[str, Any] | ColumnMap | None) -> ColumnMap | None:
        """From `FIELD=SOURCE,...`, the path of a YAML file, or a mapping; None stays None.

        Raises
        ------
        InputError
            In one sentence that names what cannot be read, and for a field the names that there are.
        """
        if given is None or isinstance(given, ColumnMap):
            return given
        if isinstance(given, Mapping):
            return cls({_target(str(key)): source_of(str(key), value) for key, value in given.items()})
        if isinstance(given, Path) or (str(given).endswith((".yaml", ".yml")) and "=" not in str(given)):
            return cls.load(_from_yaml(Path(given)))
        pairs = [part.partition("=") for part in _parts(str(given))]
        for left, equals, _ in pairs:
            if not equals:
                raise InputError(f"columns: {left.strip()!r} is not FIELD=COLUMN, for instance piston_position=pos[mm]")
        return cls.load({left.strip(): right.strip() for left, _, right in pairs})


def known_as_they_are(names: Iterable[str]) -> ColumnMap:
    """The map of a file whose columns carry the fields' own names."""
    return ColumnMap({name: Source(name) for name in names if name in TARGETS})


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
