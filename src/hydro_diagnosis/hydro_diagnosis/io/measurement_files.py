# SPDX-License-Identifier: Apache-2.0
"""MATLAB files of any version, HDF5 of any writer, MDF and TDMS.

MDF is the format of dSPACE ControlDesk, INCA and CANape, TDMS that of LabVIEW and DIAdem; the packages that read these
two (asammdf, npTDMS) are installed for them alone. ControlDesk exports .mat files, too.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager
from nptdms.reader import TdmsReader
from scipy.io import loadmat
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import (
    Columns,
    assign_clocks_of_equal_length,
    is_time,
    known,
    merge_parts,
    set_day_units,
    stated_step,
    unique,
)
from hydro_diagnosis.recording import InputError

log_manager.set_level(logging.CRITICAL)  # npTDMS would print what is reported as a note here


@contextmanager
def _read_as(kind: str) -> Iterator[None]:
    """Convert all errors of a file reader, except OSError, to ValueError."""
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        raise ValueError(f"not {kind} that can be read ({error})") from None


def matlab_columns(path: Path) -> Columns:
    """Columns of a .mat file; structs and cells are flattened with dots, matrices to `name.0`, `name.1`.

    A matrix whose columns are named by texts of the same struct gives `name.text`.

    Raises ValueError, OSError if it cannot be read.
    """
    with _read_as("a MATLAB file"):
        content = loadmat(str(path), simplify_cells=True)
    variables = {key: value for key, value in content.items() if not key.startswith("__")}
    if len(variables) == 1 and (capture := _capture(*variables.values())) is not None:
        return capture
    leaves = list(_leaves(variables))
    objects = [name for name, value in leaves if isinstance(value, (MatlabOpaque, MatlabFunction))]
    return leaves_as_columns(((name, value, "", ()) for name, value in leaves), objects)


TreeLeaf = tuple[str, Any, str, Iterable[tuple[str, Any]]]
"""Leaf of a file's tree: name, value (an array, a scalar or other), unit, and properties."""


def leaves_as_columns(leaves: Iterator[TreeLeaf], objects: list[str]) -> Columns:
    """Columns, scalars and other entries from leaves; a sampling step in a leaf's properties makes its clock.

    `objects`: names of MATLAB objects, which cannot be read; raises ValueError if there are some, but no column.
    """
    found = Columns()
    for name, value, unit, properties in leaves:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or array.ndim > 2 or array.size == 0:
            found.other.append(name)
        elif array.size == 1:
            found.constants[name] = float(array.reshape(()))
        else:
            names = [found.add(*column, unit) for column in split(name, array.astype(np.float64)).items()]
            start, step = stated_step(properties)
            if step:
                times = start + step * np.arange(len(found.series[names[0]]), dtype=np.float64)
                found.clocks.update(dict.fromkeys(names, found.clock(times)))
    set_day_units(found)
    assign_clocks_of_equal_length(found)
    if objects:
        found.notes.append(
            f"{', '.join(objects)}: objects of MATLAB cannot be read: save their numbers, of a timetable by "
            "timetable2table"
        )
        if not found.series:
            raise ValueError(found.notes[-1])
    return found


def split(name: str, array: FloatArray) -> dict[str, FloatArray]:
    """Return the columns `name.0`, `name.1`, ... of a matrix, time along its longer side; a vector is `name`."""
    upright = np.atleast_2d(array)
    upright = upright if upright.shape[0] >= upright.shape[1] else upright.T
    if array.ndim == 1 or upright.shape[1] == 1:
        return {name: upright[:, 0]}
    return {f"{name}.{k}": upright[:, k] for k in range(upright.shape[1])}


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of structs and cells: `out.signals.0.values`, `log.data.pA [bar]`."""
    if isinstance(value, Mapping):
        parts = [(str(key), _by_texts(one, value)) for key, one in value.items()]
    elif isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.dtype == object):
        parts = [(str(k), one) for k, one in enumerate(value)]
    else:
        yield name, value
        return
    for key, one in parts:
        yield from _leaves(one, f"{name}.{key}" if name else key)


def _by_texts(array: Any, beside: Mapping[str, Any]) -> Any:
    """Columns of an array by name, if texts of its struct name them or their units (`colheaders`, `label`), else it."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub" or array.size < 2 or array.ndim > 2:
        return array
    columns = list(split("", array).values())
    keys = beside if len(columns) > 1 else [key for key in beside if key.lower() in ("label", "name", "title")]
    texts = [one for key in keys if len(one := _texts(beside[key])) == len(columns)]
    units = next((one for one in texts if len(one) > 1 and all(map(known, one))), [""] * len(columns))
    names = next((one for one in texts if one is not units and all(one) and len(set(one)) == len(one)), [])
    if not names and not any(units):
        return array
    ends = [f" [{unit}]" if unit else "" for unit in units]
    return {f"{name}{end}": one for name, end, one in zip(names or map(str, count()), ends, columns, strict=False)}


def _texts(value: Any) -> list[str]:
    """A text, or an array or a list of texts, as a list; empty for anything else."""
    entries = [value] if isinstance(value, str) else list(value) if isinstance(value, (list, np.ndarray)) else []
    return [one.strip() for one in entries] if all(isinstance(one, str) for one in entries) else []


def _capture(content: Any) -> Columns | None:
    """Columns of a ControlDesk export (axes X, signals Y with Name, Data and the axis `XIndex` from 1), else None."""
    if not isinstance(content, Mapping) or not {"X", "Y"} <= set(content):
        return None
    entries = (np.atleast_1d(np.asarray(content[key], dtype=object)) for key in "XY")
    axes, signals = ([one for one in those if isinstance(one, Mapping)] for those in entries)
    if not all({"Name", "Data"} <= set(one) for one in (*axes, *signals)):
        return None
    found = Columns()

    def add(entry: Mapping[str, Any], name: str) -> str:
        return found.add(name, np.asarray(entry["Data"], dtype=np.float64).reshape(-1), str(entry.get("Unit", "")))

    clocks = [add(axis, "time") for axis in axes]
    for signal in signals:
        name, index = add(signal, str(signal["Name"])), int(signal.get("XIndex", 1)) - 1
        found.clocks[name] = clock = clocks[index if 0 <= index < len(clocks) else 0]
        if len(found.series[name]) != len(found.series[clock]):
            raise ValueError("a signal and its axis have different lengths")
    if len(axes) <= 1:
        found.clocks.clear()
    return found


def hdf5_columns(path: Path) -> Columns:
    """Columns of an HDF5 file; groups are flattened with dots, matrices to `name.0`, tables to `name.field`.

    Raises ValueError, OSError if it cannot be read.
    """
    if not h5py.is_hdf5(path):
        raise ValueError("not an HDF5 file that can be read")
    objects: list[str] = []
    with h5py.File(path, "r") as file:
        return leaves_as_columns(_hdf5_leaves(file, "", objects), objects)


def _hdf5_leaves(group: h5py.Group, prefix: str, objects: list[str]) -> Iterator[TreeLeaf]:
    """Yield arrays and the fields of tables; texts are leaves without numbers."""
    for key, item in group.items():
        if key.startswith("#"):  # MATLAB's storage of the contents of cells
            continue
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(item, h5py.Group):
            yield from _hdf5_leaves(item, name, objects)
        if not isinstance(item, h5py.Dataset):
            continue
        if "MATLAB_object_decode" in item.attrs:
            objects.append(f"{name} ({_text(item.attrs.get('MATLAB_class', 'object'))})")
            continue
        steps = [(key, _text(value)) for one in (item, item.parent) for key, value in one.attrs.items()]
        if item.dtype.names:
            yield from ((f"{name}.{field}", item[field], "", steps) for field in item.dtype.names)
        elif _text(item.attrs.get("MATLAB_class", "")) in ("char", "cell") or item.dtype.kind not in "fiub":
            yield name, "", "", ()
        else:
            keys = ("unit", "units", "Unit", "Units", "unit_string")
            unit = _text(next((item.attrs[key] for key in keys if key in item.attrs), ""))
            yield name, np.asarray(item[()]), unit, steps


def _text(value: Any) -> str:
    value = value[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def mdf_columns(path: Path) -> Columns:
    """Channels of an MDF file, each with the clock of its channel group; samples marked as invalid are NaN.

    Raises InputError if asammdf is not installed; ValueError, OSError if the file cannot be read.
    """
    try:
        from asammdf import MDF
        from asammdf.blocks.mdf_v3 import MDF3
        from asammdf.blocks.mdf_v4 import MDF4
    except ImportError:
        raise InputError(
            "an MDF file is read by asammdf, which is not installed: `python -m pip install asammdf==8.8.28`"
        ) from None
    for kind in (MDF3, MDF4):  # for an unreadable file it prints a traceback
        setattr(kind, "__del__", lambda self: None)  # noqa: B010
    parts: dict[int, Columns] = {}
    with _read_as("an MDF file"), MDF(str(path)) as file:
        for signal in file.iter_channels(skip_master=True):
            part, samples = parts.setdefault(signal.group_index, Columns()), np.asarray(signal.samples)
            if samples.dtype.kind not in "fiub" or samples.ndim != 1 or len(samples) < 2:
                part.other.append(unique(str(signal.name), part.series))
                continue
            bits = signal.invalidation_bits
            invalid = np.zeros(len(samples), dtype=bool) if bits is None else np.asarray(bits, dtype=bool)
            values = np.where(invalid, np.nan, samples.astype(np.float64))
            times = np.asarray(signal.timestamps, dtype=np.float64)
            name = part.add(str(signal.name), values, str(signal.unit))
            part.clocks[name] = part.clock(times)
            if invalid.any():
                part.notes.append(f"{int(invalid.sum())} samples of {name!r} are marked as invalid: left out")
        found = merge_parts(parts.values())
    first: dict[bytes, str] = {}  # groups sampled together share a clock
    same = {clock: first.setdefault(found.series[clock].tobytes(), clock) for clock in found.clocks.values()}
    found.clocks.update({name: same[clock] for name, clock in found.clocks.items()})
    return found


class _Starts(TdmsReader):
    """TDMS reader that records all start times of a channel; npTDMS retains the last only."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self.starts: dict[str, list[tuple[int, np.datetime64]]] = {}
        """By channel: index of the first sample after each start, and the start time."""

    def _update_object_metadata(self, segment: Any) -> None:
        self._before = {path: one.num_values for path, one in self.object_metadata.items()}
        super()._update_object_metadata(segment)

    def _update_object_properties(self, properties: Any) -> None:
        super()._update_object_properties(properties)
        for path, pairs in (properties or {}).items():
            start = dict(pairs).get("wf_start_time")
            if start is not None and (at := start.as_datetime64("ns")) > np.datetime64("1971"):
                self.starts.setdefault(path, []).append((self._before.get(path, 0), at))


def tdms_columns(path: Path) -> Columns:
    """Channels of a TDMS file, prefixed by their group if there are several; times from the waveform properties.

    The times restart at each start time that a channel states. Raises ValueError, OSError if it cannot be read.
    """
    found = Columns()
    with _read_as("a TDMS file"):
        file, reader = TdmsFile.read(str(path)), _Starts(str(path))
        reader.read_metadata()
        reader.close()
        if file.file_status.incomplete_final_segment:
            found.notes.append("the file was cut off: read up to where it ends")
    series, groups = found.series, file.groups()
    earliest = min((one[0][1] for one in reader.starts.values()), default=np.datetime64(0, "ns"))
    unsaid: list[str] = []
    for group in groups:
        prefix, named = f"{group.name}." if len(groups) > 1 else "", {}
        for channel in group.channels():
            name, values = f"{prefix}{channel.name}", np.asarray(channel[:])
            if values.dtype.kind == "M":  # times of day: since the first of them
                values = (values - values[0]) / np.timedelta64(1, "s") if len(values) else values
            if values.dtype.kind not in "fiub" or len(values) < 2:
                found.other.append(unique(name, series))
                continue
            unit = str(channel.properties.get("unit_string", channel.properties.get("NI_UnitDescription", "")))
            named[found.add(name, values.astype(np.float64), unit)] = channel
        times = [name for name in named if is_time(name, series[name])]
        for name, channel in named.items():
            step, length = float(channel.properties.get("wf_increment", 0.0)), len(series[name])
            same = [time for time in times if len(series[time]) == length]
            if step > 0.0:
                starts = reader.starts.get(channel.path, [])
                unsaid += [name] * (not starts)
                own: FloatArray = step * np.arange(length, dtype=np.float64)
                for first, start in starts:  # one that continues the count of samples is no restart
                    begin = float((start - earliest) / np.timedelta64(1, "ns")) * 1e-9
                    if first < length and (first == 0 or abs(begin - own[first]) > 0.5 * step):
                        own[first:] = begin + step * np.arange(length - first, dtype=np.float64)
                own += float(channel.properties.get("wf_start_offset", 0.0))
                found.clocks[name] = found.clock(own, prefix)
            elif same:
                found.clocks[name] = same[0]
    if reader.starts and unsaid:
        found.notes.append(f"{', '.join(unsaid)} has no start time: taken is that of the first of the others")
    for name in sorted({clock for clock in found.clocks.values() if (series[clock][:1] > 0.0).any()}):
        found.notes.append(f"{name!r} was started {1e3 * series[name][0]:.6g} ms after the first")
    return found
