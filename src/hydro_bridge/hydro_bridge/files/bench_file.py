# SPDX-License-Identifier: Apache-2.0
"""bench.yaml as plain numbers, and the digest that names them: what box, model, metric and policy are compared by.

Names, units and ranges of the numbers are `model.bench`'s; a bridge only has to say which bench its box belongs to.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.errors import UserError

_LISTS = ("effects", "closures")
_ABOUT = "learned"
"""What `learn` says of its file: no part of the bench."""
_UNSET: tuple[Any, ...] = (None, [], ())

DIGITS = 12
"""Of a digest: a mistaken pairing is not an attack."""


def digest(bench: Mapping[str, Any]) -> str:
    """SHA-256 of keys and values, its first 12 digits; what is not set counts as absent."""
    said = {key: value for key, value in bench.items() if value not in _UNSET and key != _ABOUT}
    numbers = {key: value if key in _LISTS else float(value) for key, value in said.items()}
    return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:DIGITS]


def read_numbers(path: str | Path) -> dict[str, Any]:
    """Keys and numbers of a bench.yaml, its lists `effects` and `closures` as they stand there.

    Raises
    ------
    UserError
        It cannot be read, or is no mapping of keys to numbers.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        numbers = {key: value for key, value in content.items() if key != _ABOUT}
        return {str(key): value if key in _LISTS else _number(value) for key, value in numbers.items()}
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    except (AttributeError, TypeError, ValueError, yaml.YAMLError) as error:
        raise UserError(f"{path} is no bench.yaml: {' '.join(str(error).split())}") from error


def shipped() -> Path | None:
    """The bench.yaml that hydro_sim installs, by the ament index; None where hydro_sim is not installed."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    found = (Path(prefix, "share", "hydro_sim", "config", "bench.yaml") for prefix in prefixes if prefix)
    return next((path for path in found if path.is_file()), None)


def _number(value: Any) -> float | None:
    """YAML 1.1 as PyYAML reads it takes 1e9 for text."""
    if isinstance(value, bool):
        raise ValueError(f"{value!r} is not a number")
    return None if value is None else float(value)
