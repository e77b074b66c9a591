# SPDX-License-Identifier: Apache-2.0
"""Bags without /hydro/state: numeric fields of all topics as columns `/topic.field`, with a clock per topic."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.bags.recording import STATE_TOPIC, RecordingError, read_bag, read_messages, stream_bag
from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.formats import Channel, collect
from hydro_diagnosis.recording import InputError


def has_states(path: Path) -> bool:
    """Return whether a bag holds /hydro/state. Raises InputError if it cannot be read."""
    try:
        next(stream_bag(path, skip_damaged=True), None)
        return True
    except RecordingError as error:
        try:
            there = read_bag(path, topics=(), skip_damaged=True).topics
        except RecordingError:
            there = {STATE_TOPIC: ""}
        if STATE_TOPIC in there or not there:
            raise InputError(str(error)) from None
        return False


def topic_columns(path: Path) -> Columns:
    """Numeric columns of all topics; times are the header stamps, or without a header the recorder's receive times.

    Raises InputError if the bag cannot be read.
    """
    try:
        bag = read_bag(path, skip_damaged=True)
        found, channels, unstamped = Columns(notes=list(bag.notes)), list[Channel](), list[str]()
        for topic, type_name in sorted(bag.topics.items()):
            table, stamped = bag.tables.get(topic), not type_name.startswith("std_msgs/")
            if table is not None:
                columns = {name: np.asarray(table[name], dtype=np.float64) for name in table.dtype.names or ()}
            else:
                columns, stamped = _columns_of_objects(path, topic)
            if len(columns) < 2:
                found.other.append(topic)
                continue
            unstamped += [topic] * (not stamped)
            for name in [name for name in columns if name != "time"]:
                unit = "Pa" if (type_name, name) == ("sensor_msgs/msg/FluidPressure", "fluid_pressure") else ""
                channels.append(Channel(f"{topic}.{name}", columns[name], unit, columns["time"], f"{topic}."))
    except RecordingError as error:
        raise InputError(str(error)) from None
    collect(channels, found)
    if unstamped:
        found.notes.append(f"messages on {', '.join(unstamped)} carry no time: taken is when the recorder got them")
    return found


def _columns_of_objects(path: Path, topic: str) -> tuple[dict[str, FloatArray], bool]:
    """Numeric fields of a nested message type as columns, (n,), and whether all messages are stamped."""
    times: list[float] = []
    rows: list[dict[str, float]] = []
    stamped = True
    for received, message in read_messages(path, topic, skip_damaged=True):
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        stamped = stamped and stamp is not None
        times.append(received if stamp is None else stamp.sec + 1e-9 * stamp.nanosec)
        rows.append(dict(_numbers(message, "")))
    names = [name for name in (rows[0] if rows else ()) if all(name in row for row in rows)]
    columns = {name: np.array([row[name] for row in rows]) for name in names}
    return {"time": np.array(times), **columns}, stamped


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, (list, tuple, np.ndarray)):
        for k, one in enumerate(value):
            yield from _numbers(one, f"{name}.{k}")
    elif hasattr(value, "__dataclass_fields__"):
        for key in value.__dataclass_fields__:
            if not key.startswith("_") and key not in ("header", "__msgtype__"):
                yield from _numbers(getattr(value, key), f"{name}.{key}" if name else key)
