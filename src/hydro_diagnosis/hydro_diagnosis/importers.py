# SPDX-License-Identifier: Apache-2.0
"""Files that are not bags: CSV, Parquet and MATLAB .mat, as named columns of equal length and single numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.io import loadmat

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.recording import InputError

SUFFIXES = (".csv", ".parquet", ".pq", ".mat")
"""What can be read here."""


@dataclass(frozen=True)
class Columns:
    """What a file holds."""

    series: Mapping[str, FloatArray]
    """Columns by name, each of shape (n,)."""
    constants: Mapping[str, float]
    """Single numbers by name (of .mat files)."""
    other: tuple[str, ...] = ()
    """Names of what is neither: texts, columns of another length."""


def read_columns(path: Path) -> Columns:
    """Read a file.

    Raises
    ------
    InputError
        In one sentence that names the path.
    """
    try:
        found = _mat(path) if path.suffix.lower() == ".mat" else _frame(path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except NotImplementedError:
        raise InputError(
            f"{path}: a MATLAB 7.3 file is not read: write it anew with save(..., '-v7'), or as CSV"
        ) from None
    except (ImportError, OSError, ValueError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None
    if not found.series:
        raise InputError(f"{path}: there is no column of numbers in it")
    return found


def _frame(path: Path) -> Columns:
    frame = (
        pd.read_csv(path, skipinitialspace=True, float_precision="round_trip")
        if path.suffix.lower() == ".csv"
        else pd.read_parquet(path)
    )
    numbers = {str(name): pd.to_numeric(frame[name], errors="coerce") for name in frame.columns}
    kept = {name: values.to_numpy(dtype=np.float64) for name, values in numbers.items() if values.notna().any()}
    return Columns(kept, {}, tuple(name for name in numbers if name not in kept))


def _mat(path: Path) -> Columns:
    try:
        content = loadmat(str(path), simplify_cells=True)
    except (NotImplementedError, OSError):
        raise
    except Exception as error:  # of a damaged file scipy's reader stumbles over anything
        raise ValueError(f"not a MATLAB file that can be read ({error})") from None
    series: dict[str, FloatArray] = {}
    constants: dict[str, float] = {}
    other: list[str] = []
    for name, value in _leaves({key: value for key, value in content.items() if not key.startswith("__")}):
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or array.ndim > 2:
            other.append(name)
        elif array.size == 1:
            constants[name] = float(array.reshape(()))
        else:
            series.update(_split(name, array.astype(np.float64)))
    length = max((len(values) for values in series.values()), default=0)
    other += [name for name, values in series.items() if len(values) != length]
    return Columns({name: one for name, one in series.items() if len(one) == length}, constants, tuple(other))


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Structs and cells taken apart: `out.signals.0.values`."""
    if isinstance(value, Mapping):
        parts = [(str(key), one) for key, one in value.items()]
    elif isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.dtype == object):
        parts = [(str(k), one) for k, one in enumerate(value)]
    else:
        yield name, value
        return
    for key, one in parts:
        yield from _leaves(one, f"{name}.{key}" if name else key)


def _split(name: str, array: FloatArray) -> dict[str, FloatArray]:
    """A matrix as columns `name.0`, `name.1`, ..., time along its longer side."""
    if array.ndim == 1:
        return {name: array}
    upright = array if array.shape[0] >= array.shape[1] else array.T
    if upright.shape[1] == 1:
        return {name: upright[:, 0]}
    return {f"{name}.{k}": upright[:, k] for k in range(upright.shape[1])}
