# SPDX-License-Identifier: Apache-2.0
"""MATLAB files up to version 7, including exports of dSPACE ControlDesk."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.formats.file_columns import Columns, unique, with_clocks_of_equal_length
from hydro_diagnosis.formats.units import known


def matlab_columns(path: Path) -> Columns:
    """Numbers of a .mat file; structs and cells are taken apart by dots, matrices into `name.0`, `name.1`.

    Raises
    ------
    ValueError, OSError
        If it cannot be read.
    """
    try:
        content = loadmat(str(path), simplify_cells=True)
    except (NotImplementedError, OSError):
        raise
    except Exception as error:  # of a damaged file scipy's reader stumbles over anything
        raise ValueError(f"not a MATLAB file that can be read ({error})") from None
    variables = {key: value for key, value in content.items() if not key.startswith("__")}
    captures = [value for value in variables.values() if _is_capture(value)]
    if len(captures) == 1 == len(variables):
        return _capture(captures[0])
    return leaves_as_columns(_leaves(variables), {})


def leaves_as_columns(leaves: Iterator[tuple[str, Any]], units: Mapping[str, str]) -> Columns:
    """Arrays, numbers and the rest by name as columns, single numbers and others."""
    series: dict[str, FloatArray] = {}
    constants: dict[str, float] = {}
    other: list[str] = []
    stated: dict[str, str] = {}
    for name, value in leaves:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or array.ndim > 2 or array.size == 0:
            other.append(name)
        elif array.size == 1:
            constants[name] = float(array.reshape(()))
        else:
            columns = split(name, array.astype(np.float64))
            series.update(columns)
            stated.update({column: units[name] for column in columns if name in units})
    return with_clocks_of_equal_length(series, constants, tuple(other), stated)


def split(name: str, array: FloatArray) -> dict[str, FloatArray]:
    """A matrix as columns `name.0`, `name.1`, ..., time along its longer side."""
    if array.ndim == 1:
        return {name: array}
    upright = array if array.shape[0] >= array.shape[1] else array.T
    if upright.shape[1] == 1:
        return {name: upright[:, 0]}
    return {f"{name}.{k}": upright[:, k] for k in range(upright.shape[1])}


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


def _is_capture(value: Any) -> bool:
    """Return whether a struct is what ControlDesk exports: axes X and signals Y, each with Name and Data."""
    if not isinstance(value, Mapping) or not {"X", "Y"} <= set(value):
        return False
    return all({"Name", "Data"} <= set(one) for one in (*_listed(value["X"]), *_listed(value["Y"])))


def _capture(content: Mapping[str, Any]) -> Columns:
    """Signals of a ControlDesk export by their names; `XIndex` counts its axes from 1."""
    series: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    axes = []
    for axis in _listed(content["X"]):
        axes.append(_add(axis, "time", series, units))
    for signal in _listed(content["Y"]):
        name = _add(signal, str(signal["Name"]), series, units)
        index = int(signal.get("XIndex", 1)) - 1
        clocks[name] = axes[index if 0 <= index < len(axes) else 0]
    lengths_fit = all(len(series[name]) == len(series[clock]) for name, clock in clocks.items())
    if not lengths_fit:
        raise ValueError("a signal and its axis have different lengths")
    return Columns(series, units=units, clocks=clocks if len(axes) > 1 else {})


def _add(entry: Mapping[str, Any], name: str, series: dict[str, FloatArray], units: dict[str, str]) -> str:
    column = unique(name, series)
    series[column] = np.asarray(entry["Data"], dtype=np.float64).reshape(-1)
    unit = known(str(entry.get("Unit", "")))
    if unit:
        units[column] = unit
    return column


def _listed(value: Any) -> list[Mapping[str, Any]]:
    entries = [value] if isinstance(value, Mapping) else list(np.atleast_1d(np.asarray(value, dtype=object)))
    return [entry for entry in entries if isinstance(entry, Mapping)]
