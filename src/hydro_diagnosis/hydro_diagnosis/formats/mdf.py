# SPDX-License-Identifier: Apache-2.0
"""MDF, the measurement format of dSPACE ControlDesk, INCA and CANape: by asammdf, which is installed for it alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.formats.file_columns import Columns, unique
from hydro_diagnosis.formats.units import known
from hydro_diagnosis.recording import InputError

NEEDED = "asammdf==8.8.28"
"""Package that reads MDF."""


def mdf_columns(path: Path) -> Columns:
    """Channels by name, each with the times of its channel group.

    Raises
    ------
    InputError
        If asammdf is not installed.
    ValueError, OSError
        If the file cannot be read.
    """
    try:
        from asammdf import MDF
    except ImportError:
        raise InputError(
            f"an MDF file is read by asammdf, which is not installed: `python -m pip install {NEEDED}`"
        ) from None
    try:
        with MDF(str(path)) as file:
            return _channels(file)
    except OSError:
        raise
    except Exception as error:  # of a damaged file the reader stumbles over anything
        raise ValueError(f"not an MDF file that can be read ({error})") from None


def _channels(file: Any) -> Columns:
    series: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    other: list[str] = []
    masters: list[tuple[FloatArray, str]] = []
    for signal in file.iter_channels(skip_master=True):
        name = unique(str(signal.name), series)
        values = np.asarray(signal.samples)
        if values.dtype.kind not in "fiub" or values.ndim != 1 or len(values) < 2:
            other.append(name)
            continue
        series[name] = values.astype(np.float64)
        if known(str(signal.unit)):
            units[name] = known(str(signal.unit))
        clocks[name] = _master(np.asarray(signal.timestamps, dtype=np.float64), masters, series, units)
    return Columns(series, {}, tuple(other), units, clocks)


def _master(
    times: FloatArray, masters: list[tuple[FloatArray, str]], series: dict[str, FloatArray], units: dict[str, str]
) -> str:
    """Name of the column that holds these times; groups sampled together share one."""
    for known_times, name in masters:
        if np.array_equal(known_times, times):
            return name
    name = unique("time", series)
    series[name], units[name] = times, "s"
    masters.append((times, name))
    return name
