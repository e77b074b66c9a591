# SPDX-License-Identifier: Apache-2.0
"""Files of loggers by their first bytes, whatever their names end in: text, MATLAB, HDF5, NetCDF, MDF, TDMS, Parquet.

A format is read by its library. What a file states of scale, offset and missing values is applied, or the column is
refused with what the map must say. No reader may allocate more than half of the free memory: sizes that a file
declares, or unpacks to, end in one sentence (`bounded_memory`).
"""

from __future__ import annotations

import bz2
import gzip
import logging
import lzma
import re
import resource
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

import h5py
import numpy as np
import pandas as pd
import pyarrow.parquet
from nptdms import TdmsFile
from nptdms.log import log_manager
from nptdms.reader import TdmsReader
from scipy.io import loadmat, netcdf_file
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import (
    Columns,
    assign_clocks_of_equal_length,
    merge_parts,
    set_day_units,
    stated_step,
    unique,
)
from hydro_diagnosis.io.text import numbers_of, text_columns
from hydro_diagnosis.io.units import known, split_unit, to_si
from hydro_diagnosis.recording import InputError

log_manager.set_level(logging.CRITICAL)  # npTDMS would print what is reported as a note here
MEMORY_SHARE = 0.5
"""Largest part of the free memory that the reading of a file may take."""


def read_columns(path: Path) -> Columns:
    """Read the columns of a measurement file. Raises InputError if it cannot be read; the message names the path."""
    try:
        with bounded_memory():
            found = _read(path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except MemoryError:
        raise InputError(
            f"{path}: it declares, or unpacks to, more than half of the free memory: give a part of it, or free memory"
        ) from None
    except (InputError, ImportError, OSError, ValueError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None
    if not found.series:
        said = next(iter([*found.broken.values(), *found.notes]), "there is no column of numbers in it")
        raise InputError(f"{path}: {said}")
    return found


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Let allocations beyond `MEMORY_SHARE` of the free memory raise MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize() + _memory()
    limited = soft == resource.RLIM_INFINITY or most < soft
    if limited:
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        if limited:
            resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _memory() -> int:
    """Bytes that the reading of a file may take."""
    found = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
    return int(MEMORY_SHARE * 1024 * int(found[1])) if found else 1 << 32


_FOREIGN = {
    b"|CF,": "imc FAMOS: export it from FAMOS as MDF 4, TDMS or CSV",
    b"\xd0\xcf\x11\xe0": "a spreadsheet: save its table as CSV",
    b"SQLite format 3": "an SQLite database: of a rosbag2, give its folder; else export its table as CSV",
    b"#ROSBAG": "a bag of ROS 1: rosbags-convert --src FILE --dst FOLDER",
    b"%PDF": "a PDF document", b"Rar!": "a RAR archive: unpack it", b"7z\xbc\xaf": "a 7-Zip archive: unpack it",
    b"\x28\xb5\x2f\xfd": "packed by zstd: unpack it", b"\x93NUMPY": "an array of numpy: save it as CSV, with names",
    b"ARROW1": "a Feather file: save it as Parquet",
}  # fmt: skip
"""Formats that are not read, by their first bytes, and the way out."""


def _read(path: Path) -> Columns:
    """Columns of a file. Raises InputError, ImportError, OSError, ValueError, MemoryError, EmptyDataError."""
    with path.open("rb") as file:
        head = file.read(2048)
    if h5py.is_hdf5(path):
        return hdf5_columns(path)
    readers: dict[bytes, Callable[[Path], Columns]] = {
        b"MATLAB": matlab_columns, b"MDF": mdf_columns, b"TDSm": tdms_columns, b"PAR1": parquet_columns,
        b"CDF": netcdf_columns, b"PK\x03\x04": _packed, b"\x1f\x8b": _packed, b"BZh": _packed,
        b"\xfd7zXZ": _packed,
    }  # fmt: skip
    for mark, reader in readers.items():
        if head.startswith(mark):
            return reader(path)
    text = head.lstrip(b"\xef\xbb\xbf \r\n\t")
    if text.startswith(b"<"):
        if b"usi:tdm" in text:
            raise ValueError(
                "the header of a DIAdem file (TDM): save it from DIAdem as TDMS, its .tdx alone is no table"
            )
        raise ValueError("it is a web page or XML, not a table")
    for mark, what in _FOREIGN.items():
        if head.startswith(mark):
            raise ValueError(f"it is {what}")
    wide = head[:2] in (b"\xff\xfe", b"\xfe\xff") or (
        head[1:256:2].count(0) > 64 and not head[:256:2].count(0)
    )  # UTF-16
    if not wide and sum(one < 9 or 13 < one < 27 for one in head[:256]) > 5:
        raise ValueError(f"it begins with {head[:8]!r}: no format that is read here: export it as CSV, MDF 4 or HDF5")
    return text_columns(path)


def _packed(path: Path) -> Columns:
    """Columns of the one file in an archive, unpacked into a temporary folder as far as memory would hold it."""
    with tempfile.TemporaryDirectory(prefix="hydro-") as folder:
        room = min(_memory(), 0.5 * shutil.disk_usage(folder).free)
        unpacked, size = Path(folder) / "unpacked", 0
        try:
            with path.open("rb") as packed, _opened(packed, path) as source, unpacked.open("wb") as file:
                while piece := source.read(1 << 20):
                    size += file.write(piece)
                    if size > room or size > (1 << 26) + 200 * packed.tell():
                        raise MemoryError
        except (EOFError, zipfile.BadZipFile, lzma.LZMAError) as error:
            raise ValueError(f"the archive is damaged ({error})") from None
        return _read(unpacked)


def _opened(packed: IO[bytes], path: Path) -> IO[bytes]:
    """Content of a packed file, or of the one file in an archive."""
    head = packed.read(4)
    packed.seek(0)
    if head != b"PK\x03\x04":
        return {b"\x1f\x8b": gzip.open, b"BZ": bz2.open}.get(head[:2], lzma.open)(packed, "rb")  # type: ignore[operator]
    archive = zipfile.ZipFile(packed)
    names = [one.filename for one in archive.infolist() if not one.is_dir()]
    if any(name.startswith(("xl/", "content.xml")) for name in names):
        raise ValueError("it is a spreadsheet: save its table as CSV")
    if len(names) != 1:
        raise ValueError(f"the archive holds {len(names)} files, not one: unpack it and give a file ({names[0]}, ...)")
    return archive.open(names[0])


def _declared(path: Path, size: int) -> None:
    """Refuse a file that declares more bytes than free memory may take, or than its own could be packed from."""
    if size > _memory() or size > (1 << 26) + 1000 * path.stat().st_size:
        raise MemoryError


@contextmanager
def _read_as(kind: str) -> Iterator[None]:
    """Convert all errors of a file reader, except OSError and MemoryError, to ValueError."""
    try:
        yield
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:
        raise ValueError(f"not {kind} that can be read ({error})") from None


# --- channels ------------------------------------------------------------------------------------------------------


class Channel(NamedTuple):
    """Channel of a file: numbers, texts of numbers, or a matrix of several."""

    name: str
    values: Any
    unit: str = ""
    times: FloatArray | None = None  # s, (n,)
    group: str = ""  # prefix of its clock's name
    said: Mapping[str, Any] = {}
    """What the file says of scale, offset, missing and valid values."""


def collect(channels: Iterable[Channel], found: Columns) -> Columns:
    """Add channels: one number is a constant, a matrix several columns `name.0`, `name.1`; what is neither is named."""
    for one in channels:
        array, bad = np.asarray(one.values), None
        if array.dtype == object and array.ndim == 1:
            array, bad = numbers_of(pd.Series(array))
        if bad is not None:
            found.broken[one.name] = (
                f"{one.values[bad]!r} in row {bad + 1} of {one.name!r} is not a number as the others are"
            )
        elif array.dtype.kind not in "fiub" or array.ndim > 2 or array.size == 0 or np.isnan(array).all():
            found.other.append(unique(one.name, found.series))
        elif array.size == 1:
            found.constants[one.name] = float(array.reshape(()))
        else:
            array = _scaled(found, one.name, array, one.said)
            for name, values in _split(one.name, array).items():
                column = found.add(name, values, one.unit)
                if one.times is not None:
                    found.clocks[column] = found.clock(one.times, one.group)
    set_day_units(found)
    assign_clocks_of_equal_length(found)
    return found


def _split(name: str, array: FloatArray) -> dict[str, FloatArray]:
    """Columns `name.0`, `name.1`, ... of a matrix, time along its longer side; a vector is `name`."""
    upright = np.atleast_2d(array)
    upright = upright if upright.shape[0] >= upright.shape[1] else upright.T
    if upright.shape[1] == 1:
        return {name: upright[:, 0]}
    return {f"{name}.{k}": upright[:, k] for k in range(upright.shape[1])}


_FILL_KEYS = ("_FillValue", "missing_value")
_SCALE_KEY = re.compile(
    r"(scale|gain|slope|factor|sensitivity|calib\w*|offset|intercept|bias|conversion)([_ ]?(factor|value))?", re.I
)


def _scaled(found: Columns, name: str, raw: Any, said: Mapping[str, Any]) -> FloatArray:
    """Values by the attributes of the climate and forecast conventions (CF); other scales refuse the column."""
    values = raw.astype(np.float64)
    numbers = {key: np.asarray(one, dtype=np.float64).reshape(-1) for key, one in said.items() if _is_numeric(one)}
    low, high = numbers.get("valid_range", [np.nan, np.nan])[:2]
    bad = (values < numbers.get("valid_min", [low])[0]) | (values > numbers.get("valid_max", [high])[0])
    bad |= np.isin(values, np.concatenate([numbers.get(key, np.empty(0)) for key in _FILL_KEYS]))
    scale, offset = (numbers.pop(key, np.full(1, one)) for key, one in (("scale_factor", 1.0), ("add_offset", 0.0)))
    if len(scale) == len(offset) == 1 and (scale[0], offset[0]) != (1.0, 0.0):
        values = values * scale[0] + offset[0]
        found.notes.append(f"{name!r} was scaled as the file states: * {scale[0]:g} + {offset[0]:g}")
    elif len(scale) != 1 or len(offset) != 1:
        numbers["scale_factor"] = scale
    if bad.any():
        values[bad] = np.nan
        found.notes.append(f"{int(bad.sum())} values of {name!r} are marked as missing: left out")
    for key, value in numbers.items():
        if _SCALE_KEY.fullmatch(key) and value[0] not in (0.0, 1.0):
            found.unsure[name] = (
                f"{name!r} states {key!r} = {value[0]:g}, which may be applied already: give its unit in the map, as "
                f"in FIELD='{name}'[UNIT] if it is, FIELD='{name}'[UNIT]*{value[0]:g} if not"
            )
    return np.asarray(values)


def _is_numeric(value: Any) -> bool:
    return not isinstance(value, h5py.Empty) and np.asarray(value).dtype.kind in "fiu" and np.asarray(value).size > 0


def _text(value: Any) -> str:
    value = value[0] if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


# --- trees: MATLAB, HDF5, NetCDF -----------------------------------------------------------------------------------


def matlab_columns(path: Path) -> Columns:
    """Columns of a .mat file up to version 7 (a later one is HDF5). Raises ValueError, OSError."""
    with _read_as("a MATLAB file"):
        content = loadmat(str(path), simplify_cells=True)
    return _tree_columns({key: value for key, value in content.items() if not key.startswith("__")}, Columns())


def hdf5_columns(path: Path) -> Columns:
    """Columns of an HDF5 file. Raises ValueError, OSError."""
    found, sizes = Columns(), list[int]()
    with _read_as("an HDF5 file"), h5py.File(path, "r") as file:
        file.visititems(lambda _, one: sizes.append(getattr(one, "nbytes", 0) if _is_stored(one) else 0))
        _declared(path, sum(sizes))
        return _tree_columns(_hdf5_tree(file, file, found, {}), found)


def netcdf_columns(path: Path) -> Columns:
    """Columns of a NetCDF file of version 3 (a later one is HDF5). Raises ValueError, OSError."""
    with _read_as("a NetCDF file"), netcdf_file(path, mmap=False, maskandscale=False) as file:
        _declared(path, sum(int(np.prod(one.shape)) for one in file.variables.values()))
        channels = [Channel(name, np.array(one.data), _text(vars(one).get("units", "")), said=vars(one)["_attributes"])
                    for name, one in file.variables.items()]  # fmt: skip
    return collect(channels, Columns())


def _is_stored(item: Any) -> bool:
    return not isinstance(item, h5py.Dataset) or (item.size or 0) < 2 or item.id.get_storage_size() > 0


def _hdf5_tree(file: h5py.File, item: Any, found: Columns, inherited: Mapping[str, Any]) -> Any:
    """Content of a group or dataset: mappings, lists and texts as scipy reads them of MATLAB, channels for arrays."""
    said = dict(item.attrs.items())
    if isinstance(item, h5py.Group):
        tree = {key: _hdf5_tree(file, one, found, said) for key, one in item.items() if not key.startswith("#")}
        if tree and all(isinstance(one, list) and len(one) > 1 for one in tree.values()):  # a struct array
            return [dict(zip(tree, one, strict=True)) for one in zip(*tree.values(), strict=True)]
        return tree
    kind = _text(said.get("MATLAB_class", ""))
    if "MATLAB_object_decode" in said:
        return Channel("", MatlabOpaque(np.empty(0)), kind)
    if (
        not isinstance(item, h5py.Dataset)
        or not item.size
        or _text(said.get("NAME", "")).startswith("This is a netCDF d")
    ):
        return ""
    if not _is_stored(item):
        found.notes.append(f"{item.name!r} declares {item.size} numbers, of which the file holds none")
        return ""
    if h5py.check_ref_dtype(item.dtype) is not None:
        return [_hdf5_tree(file, file[one], found, {}) if one else "" for one in item[()].reshape(-1, order="F")]
    if kind == "char":
        return "".join(map(chr, item[()].reshape(-1, order="F").tolist()))
    if item.dtype.kind not in "fiubV":
        texts = [_text(one) for one in np.atleast_1d(item[()]).reshape(-1)] if item.dtype.kind in "OS" else []
        return texts[0] if len(texts) == 1 else texts
    start, step = stated_step((key, _text(one)) for key, one in {**inherited, **said}.items())
    times = start + step * np.arange(max(item.shape, default=0), dtype=np.float64) if step else None
    if item.dtype.names:
        return {key: Channel("", item[key], times=times) for key in item.dtype.names}
    unit = next((_text(said[key]) for key in ("unit", "units", "Unit", "Units", "unit_string") if key in said), "")
    return Channel("", item[()], unit, times, said=said)


def _tree_columns(tree: Mapping[str, Any], found: Columns) -> Columns:
    """Add columns and scalars of a tree: structs and cells are flattened with dots.

    Texts beside an array name it or its columns, and their units. Raises InputError for nothing but MATLAB objects.
    """
    only = next(iter(tree.values()), None) if len(tree) == 1 else None
    if isinstance(only, Mapping) and {"X", "Y"} <= set(only):
        with suppress(KeyError, TypeError):
            return _capture(only, found)
    channels = list(_leaves(tree, ""))
    objects = [
        f"{one.name} ({one.unit})" if one.unit else one.name for one in channels if isinstance(one.values, _OBJECTS)
    ]
    collect((one for one in channels if not isinstance(one.values, _OBJECTS)), found)
    if objects:
        called = ", ".join(objects)
        found.notes.append(f"{called}: objects of MATLAB cannot be read: save numbers, a timetable by timetable2table")
        if not found.series:
            raise InputError(found.notes[-1])
    return found


_OBJECTS = (MatlabOpaque, MatlabFunction)


def _leaves(value: Any, name: str) -> Iterator[Channel]:
    """Yield the leaves of structs and cells: `out.signals.0.values`, `log.data.pA [bar]`."""
    if isinstance(value, Mapping):
        parts = [(str(key), _by_texts(one, value)) for key, one in value.items()]
    elif isinstance(value, list) or (
        isinstance(value, np.ndarray) and value.dtype == object and not isinstance(value, _OBJECTS)
    ):
        parts = [(str(k), one) for k, one in enumerate(value)]
    else:
        yield value._replace(name=name) if isinstance(value, Channel) else Channel(name, value)
        return
    for key, one in parts:
        yield from _leaves(one, f"{name}.{key}" if name else key)


def _by_texts(value: Any, beside: Mapping[str, Any]) -> Any:
    """Columns of an array by name, if texts of its struct name them or their units (`colheaders`, `label`), else it."""
    leaf = value if isinstance(value, Channel) else Channel("", value)
    if not isinstance(leaf.values, np.ndarray) or leaf.values.dtype.kind not in "fiub" or not leaf.values.size > 1:
        return value
    columns = list(_split("", leaf.values).values()) if leaf.values.ndim <= 2 else []
    alike = {key.lower(): one for key, texts in beside.items() if len(one := _texts(texts)) == len(columns)}
    if len(columns) == 1:
        alike = {key: one for key, one in alike.items() if key in ("label", "name", "title", "unit", "units")}
    units = next((one for key, one in alike.items() if all(map(known, one)) and (len(one) > 1 or "unit" in key)), [])
    names = [one for one in alike.values() if one is not units and all(one) and len(set(one)) == len(one)]
    if not names and not any(units):
        return value
    own = names[0] if names else map(str, range(len(columns)))
    ends = [f" [{unit}]" if unit else "" for unit in units or [""] * len(columns)]
    return {f"{key}{end}": leaf._replace(values=one) for key, end, one in zip(own, ends, columns, strict=True)}


def _texts(value: Any) -> list[str]:
    """A text, or an array or a list of texts, as a list; empty for anything else."""
    entries = [value] if isinstance(value, str) else list(value) if isinstance(value, (list, np.ndarray)) else []
    return [one.strip() for one in entries] if all(isinstance(one, str) for one in entries) else []


def _capture(content: Mapping[str, Any], found: Columns) -> Columns:
    """Columns of a ControlDesk export: axes X, signals Y with Name, Data and the axis `XIndex` from 1.

    Raises KeyError or TypeError if it is none.
    """
    axes, signals = (
        [(one, np.asarray(getattr(one["Data"], "values", one["Data"]), dtype=float).reshape(-1)) for one in entries]
        for entries in (np.atleast_1d(np.asarray(content[key], dtype=object)) for key in "XY")
    )  # fmt: skip
    channels = []
    for signal, values in signals:
        index = int(signal.get("XIndex", 1)) - 1
        axis, times = axes[index if 0 <= index < len(axes) else 0]
        if len(values) != len(times):
            raise ValueError("a signal and its axis have different lengths")
        seconds = times * to_si(known(str(axis.get("Unit", ""))))
        channels.append(Channel(str(signal["Name"]), values, str(signal.get("Unit", "")), seconds))
    collect(channels, found)
    if len(axes) <= 1:
        found.clocks.clear()
    return found


# --- MDF, TDMS, Parquet --------------------------------------------------------------------------------------------


def mdf_columns(path: Path) -> Columns:
    """Channels of an MDF file, each with the clock of its channel group; invalid samples and texts are NaN.

    Raises ImportError if asammdf is not installed; ValueError, OSError if the file cannot be read.
    """
    try:
        from asammdf import MDF
        from asammdf.blocks.mdf_v3 import MDF3
        from asammdf.blocks.mdf_v4 import MDF4
    except ImportError:
        raise ImportError(
            "an MDF file is read by asammdf, which is not installed: `python -m pip install asammdf==8.8.28`"
        ) from None
    for kind in (MDF3, MDF4):  # for an unreadable file it prints a traceback
        setattr(kind, "__del__", lambda self: None)  # noqa: B010
    groups: dict[int, tuple[list[Channel], Columns]] = {}
    with _read_as("an MDF file"), MDF(str(path)) as file:
        _declared(path, sum(one.channel_group.cycles_nr * len(one.channels) for one in file.groups))
        for signal in file.iter_channels(skip_master=True, raw=True):
            channels, part = groups.setdefault(signal.group_index, ([], Columns()))
            values, texts = _converted(signal)
            name, bits = str(signal.name), signal.invalidation_bits
            invalid = np.zeros(len(values), bool) if bits is None else np.asarray(bits, bool)[: len(values)]
            if invalid.any():
                values[invalid] = np.nan
                part.notes.append(f"{int(invalid.sum())} samples of {name!r} are marked as invalid: left out")
            if texts and np.isfinite(values).any():
                part.notes.append(f"{len(texts)} samples of {name!r} are texts ({texts[0]!r}): left out")
            channels.append(Channel(name, values, str(signal.unit), np.asarray(signal.timestamps, dtype=np.float64)))
        found = merge_parts(collect(channels, part) for channels, part in groups.values())
    first: dict[bytes, str] = {}  # groups sampled together share a clock
    same = {clock: first.setdefault(found.series[clock].tobytes(), clock) for clock in found.clocks.values()}
    found.clocks.update({name: same[clock] for name, clock in found.clocks.items()})
    return found


def _converted(signal: Any) -> tuple[FloatArray, list[str]]:
    """Physical values of a raw signal, NaN where its conversion gives a text, and these texts."""
    raw = np.asarray(signal.samples)
    if raw.dtype.kind not in "fiub" or raw.ndim != 1:
        return np.empty(0), []
    samples = raw
    if signal.conversion is not None:
        samples = np.asarray(signal.conversion.convert(raw, ignore_value2text_conversions=False))
    if samples.dtype.kind in "fiub":
        return samples.astype(np.float64), []
    words = [one.decode(errors="replace") if isinstance(one, bytes) else one for one in samples.tolist()]
    values = pd.to_numeric(pd.Series(words, dtype=object), errors="coerce").to_numpy(dtype=np.float64, copy=True)
    plain = np.array([one == "" for one in words])  # texts of some values only: the others are numbers
    values[plain] = raw[plain]
    return values, [str(one) for one, bad in zip(words, ~np.isfinite(values), strict=True) if bad]


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
                known_starts = self.starts.setdefault(path, [])
                if not known_starts or known_starts[-1][1] != at:  # each segment may repeat it
                    known_starts.append((self._before.get(path, 0), at))


_TDMS_SCALES = ("Polynomial", "Linear", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract",
                "AdvancedAPI")  # fmt: skip
"""Scalings that npTDMS applies; it drops others with all that follow."""


def tdms_columns(path: Path) -> Columns:
    """Channels of a TDMS file, prefixed by their group if there are several; times from the waveform properties.

    The times restart at each new start time that a channel states. Raises ValueError, OSError if it cannot be read.
    """
    found = Columns()
    with _read_as("a TDMS file"):
        reader = _Starts(str(path))
        reader.read_metadata()
        reader.close()
        _declared(path, sum(one.num_values for one in reader.object_metadata.values()))
        file = TdmsFile.read(str(path))
        if file.file_status.incomplete_final_segment:
            found.notes.append("the file was cut off: read up to where it ends")
    earliest = min((one[0][1] for one in reader.starts.values()), default=np.datetime64(0, "ns"))
    channels, unsaid = list[Channel](), list[str]()
    for group in file.groups():
        prefix = f"{group.name}." if len(file.groups()) > 1 else ""
        for channel in group.channels():
            name, values, said = f"{prefix}{channel.name}", np.asarray(channel[:]), channel.properties
            if values.dtype.kind == "M":  # times of day: since the first of them
                values = (values - values[:1]) / np.timedelta64(1, "s")
            step, times = float(said.get("wf_increment", 0.0)), None
            if step > 0.0:
                times = step * np.arange(len(values), dtype=np.float64)
                unsaid += [name] * (channel.path not in reader.starts)
                for first, start in reader.starts.get(channel.path, []):  # one that goes on counting is no restart
                    begin = float((start - earliest) / np.timedelta64(1, "ns")) * 1e-9
                    if first < len(values) and (first == 0 or abs(begin - times[first]) > 0.5 * step):
                        times[first:] = begin + step * np.arange(len(values) - first, dtype=np.float64)
                times += float(said.get("wf_start_offset", 0.0))
            scales = [str(one) for key, one in said.items() if re.fullmatch(r"NI_Scale\[\d+\]_Scale_Type", key)]
            odd = [one for one in scales if one not in _TDMS_SCALES and said.get("NI_Scaling_Status") != "scaled"]
            if odd:
                found.unsure[name] = (
                    f"{name!r} is to be scaled by {odd[0]!r}, which npTDMS does not: give unit and factor in the map, "
                    f"as in FIELD='{name}'[UNIT]*FACTOR+OFFSET"
                )
            unit = str(said.get("unit_string", said.get("NI_UnitDescription", "")))
            channels.append(Channel(name, values, unit, times, prefix))
    collect(channels, found)
    if reader.starts and unsaid:
        found.notes.append(f"{', '.join(unsaid)} has no start time: taken is that of the first of the others")
    for name in sorted({clock for clock in found.clocks.values() if (found.series[clock][:1] > 0.0).any()}):
        found.notes.append(f"{name!r} was started {1e3 * found.series[name][0]:.6g} ms after the first")
    return found


def parquet_columns(path: Path) -> Columns:
    """Columns and index of a data frame; dates, durations and texts are read as those of a text table."""
    with _read_as("a Parquet file"):
        said = pyarrow.parquet.read_metadata(path)
        _declared(path, 8 * said.num_rows * said.num_columns)
        frame, channels = pd.read_parquet(path), list[Channel]()
    columns = [(str(name), cells) for name, cells in frame.items()]
    if not isinstance(frame.index, pd.RangeIndex):
        levels = (frame.index.get_level_values(k).to_series() for k in range(frame.index.nlevels))
        columns = [(str(one.name or ("time" if one.dtype.kind in "fmM" else "index")), one) for one in levels] + columns
    for name, cells in columns:
        if cells.dtype.kind in "mM":
            start = cells.iloc[0] if cells.dtype.kind == "M" else pd.Timedelta(0)
            channels.append(Channel(name, (cells - start).dt.total_seconds().to_numpy(dtype=np.float64), "s"))
        elif pd.api.types.is_numeric_dtype(cells):
            values = cells.to_numpy(dtype=np.float64, na_value=np.nan)
            channels.append(Channel(name, values, split_unit(name)[1]))
        else:
            channels.append(Channel(name, cells.to_numpy(dtype=object), split_unit(name)[1]))
    return collect(channels, Columns())
