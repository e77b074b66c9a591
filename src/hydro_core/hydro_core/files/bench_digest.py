# SPDX-License-Identifier: Apache-2.0
"""Digest of a bench.yaml, by which box, model, metric and policy are matched, and a reader of its plain parameters.

Names, units and ranges are not checked: `hydro_sim.model.bench.Bench` defines them. A bridge only has to report its
box's bench.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydro_core.errors import UserError
from hydro_core.settings import read_yaml

_LIST_KEYS = ("effects", "closures")
_DESCRIPTION_KEY = "learned"
"""Key under which `learn` describes its file; not part of the bench."""


def digest(bench: Mapping[str, Any]) -> str:
    """Return a bench's digest: the first 12 digits of the SHA-256 of its keys and values, unset ones omitted."""
    said = {key: value for key, value in bench.items() if value not in (None, [], ()) and key != _DESCRIPTION_KEY}
    numbers = {key: value if key in _LIST_KEYS else float(value) for key, value in said.items()}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:12]


def read_parameters(path: str | Path) -> dict[str, Any]:
    """Return the parameters of a bench.yaml by key, with its lists `effects` and `closures` unchanged.

    Raises UserError: the file cannot be read, or is not a mapping of keys to numbers.
    """
    numbers = {str(key): value for key, value in read_yaml(path).items() if key != _DESCRIPTION_KEY}
    for key, value in numbers.items():
        if value is not None and key not in _LIST_KEYS:
            try:
                numbers[key] = float(value)  # PyYAML (YAML 1.1) reads some numbers as text, such as 1e9
                if isinstance(value, bool):
                    raise ValueError
            except (TypeError, ValueError):
                raise UserError(f"{path} is not a bench.yaml: {key} is {value!r}, not a number") from None
    return numbers


def shipped_bench_file() -> Path | None:
    """Return the path of the bench.yaml installed by hydro_sim, from the ament index; None without hydro_sim."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    found = (Path(prefix, "share", "hydro_sim", "config", "bench.yaml") for prefix in prefixes if prefix)
    return next((path for path in found if path.is_file()), None)
