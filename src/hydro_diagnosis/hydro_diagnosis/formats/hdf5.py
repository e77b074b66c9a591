# SPDX-License-Identifier: Apache-2.0
"""HDF5 of any writer, MATLAB 7.3 among them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hydro_diagnosis.formats.file_columns import Columns
from hydro_diagnosis.formats.matlab import leaves_as_columns
from hydro_diagnosis.formats.units import known

_UNIT_KEYS = ("unit", "units", "Unit", "Units", "unit_string")


def is_hdf5(path: Path) -> bool:
    """Return whether a file is HDF5, whatever its name; a MATLAB 7.3 file is, behind a header of 512 bytes."""
    return bool(h5py.is_hdf5(str(path)))


def hdf5_columns(path: Path) -> Columns:
    """Numbers of an HDF5 file, groups by dots, matrices and the fields of tables into `name.0` and `name.field`.

    Raises
    ------
    ValueError, OSError
        If it cannot be read.
    """
    if not is_hdf5(path):
        raise ValueError("not an HDF5 file that can be read")
    units: dict[str, str] = {}
    with h5py.File(path, "r") as file:
        return leaves_as_columns(_leaves(file, "", units), units)


def _leaves(group: h5py.Group, prefix: str, units: dict[str, str]) -> Iterator[tuple[str, Any]]:
    for key, item in group.items():
        if key.startswith("#"):  # where MATLAB keeps what its cells refer to
            continue
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(item, h5py.Group):
            yield from _leaves(item, name, units)
        elif isinstance(item, h5py.Dataset):
            yield from _dataset(item, name, units)


def _dataset(item: h5py.Dataset, name: str, units: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """One array, or the fields of a table; texts come as texts, which are no columns."""
    unit = known(_text(next((item.attrs[key] for key in _UNIT_KEYS if key in item.attrs), "")))
    if item.dtype.names:
        yield from ((f"{name}.{field}", item[field]) for field in item.dtype.names)
    elif _text(item.attrs.get("MATLAB_class", "")) in ("char", "cell") or item.dtype.kind not in "fiub":
        yield name, ""
    else:
        if unit:
            units[name] = unit
        array = np.asarray(item[()])
        yield name, array


def _text(value: Any) -> str:
    value = value[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
