# SPDX-License-Identifier: Apache-2.0
"""MDF, the format of dSPACE ControlDesk, INCA and CANape, and TDMS, that of LabVIEW and DIAdem.

The packages that read them (asammdf, npTDMS) are installed for them alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.io.columns import Columns, known, named_like_time, runs_forward, unique
from hydro_diagnosis.recording import InputError

NEEDED = "asammdf==8.8.28"
"""Package that reads MDF."""


def mdf_columns(path: Path) -> Columns:
    """Channels by name, each with the times of its channel group.

    Raises InputError if asammdf is not installed; ValueError, OSError if the file cannot be read.
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


def tdms_columns(path: Path) -> Columns:
    """Channels by name, with their group in front where there are several; times from the waveform's properties.

    Raises ValueError, OSError if it cannot be read.
    """
    try:
        file = TdmsFile.read(str(path))
    except OSError:
        raise
    except Exception as error:  # of a damaged file the reader stumbles over anything
        raise ValueError(f"not a TDMS file that can be read ({error})") from None
    series: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    other: list[str] = []
    groups = file.groups()
    for group in groups:
        prefix = f"{group.name}." if len(groups) > 1 else ""
        named = _numbers(group, prefix, series, units, other)
        waveforms: dict[tuple[float, float, int], str] = {}
        times = [name for name in named if named_like_time(name) and runs_forward(series[name])]
        for name, channel in named.items():
            clock = _clock(channel, len(series[name]), waveforms, prefix, series, units)
            same = [time for time in times if len(series[time]) == len(series[name])]
            if clock or same:
                clocks[name] = clock or same[0]
    return Columns(series, {}, tuple(other), units, clocks)


def _numbers(
    group: Any, prefix: str, series: dict[str, FloatArray], units: dict[str, str], other: list[str]
) -> dict[str, Any]:
    """Channels of a group that hold numbers, by the names under which they are added to `series`."""
    named = {}
    for channel in group.channels():
        name = unique(f"{prefix}{channel.name}", series)
        values = np.asarray(channel[:])
        if values.dtype.kind == "M":  # times of day: since the first of them
            values = (values - values[0]) / np.timedelta64(1, "s") if len(values) else values
        if values.dtype.kind not in "fiub" or len(values) < 2:
            other.append(name)
            continue
        series[name] = values.astype(np.float64)
        named[name] = channel
        unit = known(str(channel.properties.get("unit_string", channel.properties.get("NI_UnitDescription", ""))))
        if unit:
            units[name] = unit
    return named


def _clock(
    channel: Any,
    length: int,
    waveforms: dict[tuple[float, float, int], str],
    prefix: str,
    series: dict[str, FloatArray],
    units: dict[str, str],
) -> str:
    """Name of the column of times that a channel's waveform properties make; empty if it has none."""
    step = float(channel.properties.get("wf_increment", 0.0))
    if step <= 0.0:
        return ""
    start = float(channel.properties.get("wf_start_offset", 0.0))
    if (start, step, length) not in waveforms:
        name = unique(f"{prefix}time", series)
        series[name] = start + step * np.arange(length, dtype=np.float64)
        units[name] = "s"
        waveforms[start, step, length] = name
    return waveforms[start, step, length]
