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
from hydro_diagnosis.io.columns import Columns, named_like_time, runs_forward, unique
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
    found = Columns()
    for signal in file.iter_channels(skip_master=True):
        values = np.asarray(signal.samples)
        if values.dtype.kind not in "fiub" or values.ndim != 1 or len(values) < 2:
            found.other.append(unique(str(signal.name), found.series))
            continue
        name = found.add(str(signal.name), values.astype(np.float64), str(signal.unit))
        found.clocks[name] = _master(np.asarray(signal.timestamps, dtype=np.float64), found)
    return found


def _master(times: FloatArray, found: Columns) -> str:
    """Name of the column that holds these times; groups sampled together share one."""
    masters = dict.fromkeys(found.clocks.values())
    same = (name for name in masters if np.array_equal(found.series[name], times))
    return next(same, "") or found.add("time", times, "s")


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
    found = Columns()
    series, groups = found.series, file.groups()
    for group in groups:
        prefix = f"{group.name}." if len(groups) > 1 else ""
        named = _numbers(group, prefix, found)
        waveforms: dict[tuple[float, float, int], str] = {}
        times = [name for name in named if named_like_time(name) and runs_forward(series[name])]
        for name, channel in named.items():
            clock = _clock(channel, len(series[name]), waveforms, prefix, found)
            same = [time for time in times if len(series[time]) == len(series[name])]
            if clock or same:
                found.clocks[name] = clock or same[0]
    return found


def _numbers(group: Any, prefix: str, found: Columns) -> dict[str, Any]:
    """Channels of a group that hold numbers, by the names under which they are added."""
    named = {}
    for channel in group.channels():
        name, values = f"{prefix}{channel.name}", np.asarray(channel[:])
        if values.dtype.kind == "M":  # times of day: since the first of them
            values = (values - values[0]) / np.timedelta64(1, "s") if len(values) else values
        if values.dtype.kind not in "fiub" or len(values) < 2:
            found.other.append(unique(name, found.series))
            continue
        unit = str(channel.properties.get("unit_string", channel.properties.get("NI_UnitDescription", "")))
        named[found.add(name, values.astype(np.float64), unit)] = channel
    return named


def _clock(
    channel: Any,
    length: int,
    waveforms: dict[tuple[float, float, int], str],
    prefix: str,
    found: Columns,
) -> str:
    """Name of the column of times that a channel's waveform properties make; empty if it has none."""
    step = float(channel.properties.get("wf_increment", 0.0))
    if step <= 0.0:
        return ""
    start = float(channel.properties.get("wf_start_offset", 0.0))
    if (start, step, length) not in waveforms:
        times = start + step * np.arange(length, dtype=np.float64)
        waveforms[start, step, length] = found.add(f"{prefix}time", times, "s")
    return waveforms[start, step, length]
