# SPDX-License-Identifier: Apache-2.0
"""One recording as the loggers of benches write it: small files by the real libraries, ControlDesk's CSV by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
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
Write = Callable[[Path, StateArray], Path]


def raw(states: StateArray) -> tuple[Array, dict[str, Array]]:
    """Times from 0 on [s], and channels in the units of the file."""
    time = np.arange(len(states)) * 1e-3
    return time, {name: states[field] / factor for name, (field, _, factor) in CHANNELS.items()}


def slow_temperature(time: Array) -> Array:
    """What a logger adds at 10 Hz."""
    return 40.0 + 0.1 * np.round(time[::100], 1)


def control_desk_csv(folder: Path, states: StateArray) -> Path:
    """Keyed header, two rasters with a column of times each, degrees Celsius in the encoding of Windows."""
    time, channels = raw(states)
    names = ["", *channels, "", "T_oil"]
    units = ["s", *(unit for _, unit, _ in CHANNELS.values()), "s", "°C"]
    rows = [
        ["FILE_TYPE", "ControlDesk measurement"],
        ["DESCRIPTION", "Prüfstand ¿kalt?"],
        [],
        ["type", "x_axis", *["y_axis"] * len(channels), "x_axis", "y_axis"],
        ["path", *(f"Model Root/{name}/Out1" if name else "" for name in names)],
        ["unit", *units],
        ["raster", *["Periodic Task 1"] * (1 + len(channels)), *["Periodic Task 2"] * 2],
    ]
    slow, temperature = time[::100], slow_temperature(time)
    lines = [";".join(row) for row in rows]
    for k, at in enumerate(time):
        numbers = [at, *(values[k] for values in channels.values())]
        late = [slow[k], temperature[k]] if k < len(slow) else []
        cells = [repr(float(one)).replace(".", ",") for one in (*numbers, *late)]
        lines.append(";".join(["trace_values" if k == 0 else "", *cells, *[""] * (2 - len(late))]))
    path = folder / "control_desk.csv"
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))
    return path


def plain_csv(folder: Path, states: StateArray) -> Path:
    """Tabs, decimal commas, a row of units, UTF-16."""
    time, channels = raw(states)
    lines = ["\t".join(["Zeit", *channels]), "\t".join(["[s]", *(f"[{unit}]" for _, unit, _ in CHANNELS.values())])]
    for k, at in enumerate(time):
        lines.append("\t".join(repr(float(one)).replace(".", ",") for one in (at, *(v[k] for v in channels.values()))))
    path = folder / "plain.csv"
    path.write_text("\n".join(lines), encoding="utf-16")
    return path


def blocks_csv(folder: Path, states: StateArray) -> Path:
    """One block per raster, one below the other."""
    time, channels = raw(states)
    head = ["time [s],T_oil"]
    head += [f"{at:.3f},{value:.2f}" for at, value in zip(time[::100], slow_temperature(time), strict=True)]
    head += ["", "time [s]," + ",".join(f"{name} [{CHANNELS[name][1]}]" for name in channels)]
    rows = [",".join(repr(float(one)) for one in row) for row in zip(time, *channels.values(), strict=True)]
    path = folder / "blocks.csv"
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path


def mdf(folder: Path, states: StateArray) -> Path:
    """Two channel groups, 1 kHz and 10 Hz."""
    from asammdf import MDF, Signal

    time, channels = raw(states)
    file = MDF(version="4.10")
    file.append([Signal(v, time, name=name, unit=CHANNELS[name][1]) for name, v in channels.items()])
    file.append([Signal(slow_temperature(time), time[::100], name="T_oil", unit="degC")])
    path = folder / "recording.mf4"
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
            item = group.create_dataset(name, data=values[None, :])
            item.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("note", data=np.frombuffer("kalt".encode("utf-16-le"), np.uint16)[:, None])
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def matlab_capture(folder: Path, states: StateArray) -> Path:
    """As ControlDesk writes .mat files: a struct of axes X and signals Y."""
    time, channels = raw(states)
    axes = [{"Name": "Clock", "Data": time, "Unit": "s"}, {"Name": "Slow", "Data": time[::100], "Unit": "s"}]
    signals = [{"Name": name, "Data": v, "Unit": CHANNELS[name][1], "XIndex": 1} for name, v in channels.items()]
    signals.append({"Name": "T_oil", "Data": slow_temperature(time), "Unit": "degC", "XIndex": 2})
    path = folder / "capture.mat"
    savemat(path, {"rec1": {"X": axes, "Y": signals, "Description": "cold"}})
    return path


def hdf5(folder: Path, states: StateArray) -> Path:
    """Groups by rate, units as attributes."""
    time, channels = raw(states)
    path = folder / "recording.h5"
    with h5py.File(path, "w") as file:
        for name, values in {"time": time, **channels}.items():
            item = file.create_dataset(f"fast/{name}", data=values)
            item.attrs["unit"] = "s" if name == "time" else CHANNELS[name][1]
        file["slow/time"], file["slow/T_oil"] = time[::100], slow_temperature(time)
    return path


def tdms(folder: Path, states: StateArray) -> Path:
    """Waveforms whose times stand in their properties."""
    time, channels = raw(states)
    path = folder / "recording.tdms"
    with TdmsWriter(path) as writer:
        fast = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_samples": len(time)}
        objects = [
            ChannelObject("fast", name, values, properties={**fast, "unit_string": CHANNELS[name][1]})
            for name, values in channels.items()
        ]
        objects.append(ChannelObject("slow", "T_oil", slow_temperature(time), properties={"wf_increment": 0.1}))
        writer.write_segment(objects)
    return path


def topics(folder: Path, states: StateArray) -> Path:
    """A bag of another graph: Float64, FluidPressure and JointState, 1 kHz each."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    path = folder / "topics"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def connect(topic: str, name: str) -> tuple[object, str]:
            return writer.add_connection(topic, name, typestore=store), name

        force = connect("/force", "std_msgs/msg/Float64")
        load = connect("/load", "std_msgs/msg/Float64")
        current = connect("/valve", "std_msgs/msg/Float64")
        joint = connect("/joint_states", "sensor_msgs/msg/JointState")
        pressures = [connect(f"/pressure_{side}", "sensor_msgs/msg/FluidPressure") for side in "ab"]

        def write(connection: tuple[object, str], at: int, message: object) -> None:
            writer.write(connection[0], at, store.serialize_cdr(message, connection[1]))  # type: ignore[arg-type]

        for k, row in enumerate(states):
            at = 1_700_000_000_000_000_000 + k * 1_000_000
            stamp = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="bench")
            for connection, field in ((force, "hydraulic_force"), (load, "load_force"), (current, "valve_current")):
                write(connection, at, types["std_msgs/msg/Float64"](data=float(row[field])))
            for connection, field in zip(pressures, ("pressure_a", "pressure_b"), strict=True):
                pressure = types["sensor_msgs/msg/FluidPressure"](
                    header=header, fluid_pressure=float(row[field]), variance=0.0
                )
                write(connection, at, pressure)
            none, place = np.empty(0), np.array([row["piston_position"]])
            message = types["sensor_msgs/msg/JointState"](
                header=header, name=["cylinder"], position=place, velocity=none, effort=none
            )
            write(joint, at, message)
    return path


TOPICS = (
    "hydraulic_force='/force.data',load_force='/load.data',valve_current='/valve.data',"
    "pressure_a='/pressure_a.fluid_pressure',pressure_b='/pressure_b.fluid_pressure',"
    "piston_position='/joint_states.position.0'"
)
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
