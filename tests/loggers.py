# SPDX-License-Identifier: Apache-2.0
"""One recording as the loggers of benches write it: small files by the real libraries, ControlDesk's CSV by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
from nptdms import ChannelObject, TdmsWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from hydro_core.signals import StateArray

Array = npt.NDArray[np.float64]
CHANNELS = {
    "F_hyd": ("hydraulic_force", "N", 1.0),
    "F_load": ("load_force", "kN", 1e3),
    "pA": ("pressure_a", "bar", 1e5),
    "pB": ("pressure_b", "bar", 1e5),
    "x": ("piston_position", "mm", 1e-3),
    "i_valve": ("valve_current", "mA", 1e-3),
}
"""Name in the file: field, unit in the file, SI over unit."""
UNITS = {name: unit for name, (_, unit, _) in CHANNELS.items()}
Write = Callable[[Path, StateArray], Path]


def raw(states: StateArray) -> tuple[Array, dict[str, Array]]:
    """Times from 0 on [s], and channels in the units of the file."""
    time = np.arange(len(states)) * 1e-3
    return time, {name: states[field] / factor for name, (field, _, factor) in CHANNELS.items()}


def slow_temperature(time: Array) -> tuple[Array, Array]:
    """Times [s] and values of what a logger adds at 10 Hz."""
    return time[::100], 40.0 + 0.1 * np.round(time[::100], 1)


def with_comma(number: float) -> str:
    return repr(float(number)).replace(".", ",")


def control_desk_csv(folder: Path, states: StateArray) -> Path:
    """Keyed header, two rasters with a column of times each, degrees Celsius in the encoding of Windows."""
    time, channels = raw(states)
    slow = [*zip(*slow_temperature(time), strict=True)]
    rows = [
        ["FILE_TYPE", "ControlDesk measurement"],
        ["DESCRIPTION", "Prüfstand ¿kalt?"],
        [],
        ["type", "x_axis", *["y_axis"] * len(channels), "x_axis", "y_axis"],
        ["path", *(f"Model Root/{name}/Out1" if name else "" for name in ("", *channels, "", "T_oil"))],
        ["unit", "s", *UNITS.values(), "s", "°C"],
        ["raster", *["Periodic Task 1"] * (1 + len(channels)), *["Periodic Task 2"] * 2],
    ]
    for k, numbers in enumerate(zip(time, *channels.values(), strict=True)):
        late = [*map(with_comma, slow[k])] if k < len(slow) else ["", ""]
        rows.append(["trace_values" if k == 0 else "", *map(with_comma, numbers), *late])
    path = folder / "control_desk.csv"
    path.write_bytes("".join(";".join(row) + "\r\n" for row in rows).encode("cp1252"))
    return path


def plain_csv(folder: Path, states: StateArray) -> Path:
    """Tabs, decimal commas, a row of units, UTF-16."""
    time, channels = raw(states)
    table = {("Zeit", "[s]"): time, **{(name, f"[{UNITS[name]}]"): values for name, values in channels.items()}}
    path = folder / "plain.csv"
    pd.DataFrame(table).to_csv(path, sep="\t", decimal=",", encoding="utf-16", index=False)
    return path


def blocks_csv(folder: Path, states: StateArray) -> Path:
    """One block per raster, one below the other."""
    time, channels = raw(states)
    slow = dict(zip(("time [s]", "T_oil"), slow_temperature(time), strict=True))
    fast = {"time [s]": time, **{f"{name} [{UNITS[name]}]": values for name, values in channels.items()}}
    path = folder / "blocks.csv"
    path.write_text("\n".join(pd.DataFrame(block).to_csv(index=False) for block in (slow, fast)))
    return path


def mdf(folder: Path, states: StateArray) -> Path:
    """Two channel groups, 1 kHz and 10 Hz."""
    from asammdf import MDF, Signal

    time, channels = raw(states)
    slow, temperature = slow_temperature(time)
    path, file = folder / "recording.mf4", MDF(version="4.10")
    file.append([Signal(values, time, name=name, unit=UNITS[name]) for name, values in channels.items()])
    file.append([Signal(temperature, slow, name="T_oil", unit="degC")])
    file.save(path, overwrite=True)
    file.close()
    return path


def matlab_73(folder: Path, states: StateArray) -> Path:
    """As `save -v7.3` writes it: HDF5 behind a header of 512 bytes, rows and columns exchanged, a struct as a group."""
    time, channels = raw(states)
    path = folder / "recording73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in {"t": time, **channels}.items():
            group[name] = values[None, :]
            group[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["note"] = np.frombuffer("kalt".encode("utf-16-le"), np.uint16)[:, None]
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def matlab_capture(folder: Path, states: StateArray) -> Path:
    """As ControlDesk writes .mat files: a struct of axes X and signals Y."""
    time, channels = raw(states)
    slow, temperature = slow_temperature(time)
    axes = [{"Name": "Clock", "Data": time, "Unit": "s"}, {"Name": "Slow", "Data": slow, "Unit": "s"}]
    signals = [{"Name": name, "Data": v, "Unit": UNITS[name], "XIndex": 1} for name, v in channels.items()]
    signals.append({"Name": "T_oil", "Data": temperature, "Unit": "degC", "XIndex": 2})
    path = folder / "capture.mat"
    savemat(path, {"rec1": {"X": axes, "Y": signals, "Description": "cold"}})
    return path


def hdf5(folder: Path, states: StateArray) -> Path:
    """Groups by rate, units as attributes."""
    time, channels = raw(states)
    path = folder / "recording.h5"
    with h5py.File(path, "w") as file:
        for name, values in {"time": time, **channels}.items():
            file[f"fast/{name}"] = values
            file[f"fast/{name}"].attrs["unit"] = UNITS.get(name, "s")
        file["slow/time"], file["slow/T_oil"] = slow_temperature(time)
    return path


def tdms(folder: Path, states: StateArray) -> Path:
    """Waveforms whose times stand in their properties."""
    time, channels = raw(states)
    fast = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_samples": len(time)}
    objects = [
        ChannelObject("fast", name, values, properties={**fast, "unit_string": UNITS[name]})
        for name, values in channels.items()
    ]
    objects.append(ChannelObject("slow", "T_oil", slow_temperature(time)[1], properties={"wf_increment": 0.1}))
    path = folder / "recording.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment(objects)
    return path


FLOAT, PRESSURE, JOINT = "std_msgs/msg/Float64", "sensor_msgs/msg/FluidPressure", "sensor_msgs/msg/JointState"
SOURCES = {
    "/force": (FLOAT, "data", "hydraulic_force"),
    "/load": (FLOAT, "data", "load_force"),
    "/valve": (FLOAT, "data", "valve_current"),
    "/pressure_a": (PRESSURE, "fluid_pressure", "pressure_a"),
    "/pressure_b": (PRESSURE, "fluid_pressure", "pressure_b"),
    "/joint_states": (JOINT, "position.0", "piston_position"),
}
"""Topics: type, member, field."""
TOPICS = ",".join(f"{field}='{topic}.{member}'" for topic, (_, member, field) in SOURCES.items())


def topics(folder: Path, states: StateArray) -> Path:
    """A bag of another graph: Float64, FluidPressure and JointState, 1 kHz each."""
    store, path, none = get_typestore(Stores.ROS2_JAZZY), folder / "topics", np.empty(0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store) for topic, (kind, *_) in SOURCES.items()
        }
        for k, row in enumerate(states):
            at = 1_700_000_000_000_000_000 + k * 1_000_000
            stamp = store.types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="bench")
            rest = {FLOAT: {}, PRESSURE: {"header": header, "variance": 0.0},
                    JOINT: {"header": header, "name": ["cylinder"], "velocity": none, "effort": none}}  # fmt: skip
            for topic, (kind, member, field) in SOURCES.items():
                value = np.array([row[field]]) if kind == JOINT else float(row[field])
                message = store.types[kind](**{member.removesuffix(".0"): value}, **rest[kind])
                writer.write(connections[topic], at, store.serialize_cdr(message, kind))
    return path


FORMATS: dict[str, tuple[Write, str]] = {
    "ControlDesk CSV": (control_desk_csv, ""),
    "CSV, UTF-16": (plain_csv, ""),
    "CSV in blocks": (blocks_csv, ""),
    "MDF 4": (mdf, ""),
    "MAT 7.3": (matlab_73, ""),
    "ControlDesk MAT": (matlab_capture, ""),
    "HDF5": (hdf5, ""),
    "TDMS": (tdms, ""),
    "ROS 2 topics": (topics, TOPICS),
}
"""How a format is written and mapped; where no map stands, the one that `inspect` proposes is taken."""
