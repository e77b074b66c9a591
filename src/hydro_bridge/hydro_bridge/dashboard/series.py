# SPDX-License-Identifier: Apache-2.0
"""Columns that the page plots, with their units, extracted from serialized messages.

`described` gives the page their names and units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.cdr import FixedLayout, fixed_layout
from hydro_bridge.bags.schema import definition
from hydro_bridge.signals import Flag, FloatArray

STATE_TYPE = "hydro_msgs/msg/BenchState"
CORRECTION_TYPE = "hydro_msgs/msg/Correction"
LAW_TYPE = "hydro_msgs/msg/LawState"


@dataclass(frozen=True)
class Column:
    """One plotted series: a field of a message in the page's unit."""

    name: str
    field: str
    unit: str = ""
    scale: float = 1.0
    """Unit of the page / SI."""


STATE_COLUMNS = (
    Column("reference", "reference_force", "N"),
    Column("force", "load_force", "N"),
    Column("hydraulic force", "hydraulic_force", "N"),
    Column("K_p", "proportional_gain", "1/s"),
    Column("K_i", "integral_gain", "1/s²"),
    Column("current", "valve_current", "mA", 1e3),
    Column("pressure a", "pressure_a", "bar", 1e-5),
    Column("pressure b", "pressure_b", "bar", 1e-5),
    Column("position", "piston_position", "mm", 1e3),
)
CORRECTION_COLUMNS = (
    Column("correction", "delta_u", "mA", 1e3),
    Column("without correction", "certificate_before", "1/s"),
    Column("with correction", "certificate_after", "1/s"),
)
LAW_COLUMNS = (
    Column("f_c", "compensated_reference", "N"),
    Column("a_0", "a_0", "%", 1e2),
    Column("a_1", "a_1", "ms", 1e3),
    Column("a_2", "a_2", "10⁻⁵ s²", 1e5),
    Column("a_3", "a_3", "N"),
)
STATE_EXTRA = (Column("error", "", "N"), Column("armed", ""), Column("tripped", ""))
"""Columns derived from the state's fields: f_r - f_l; 1 or 0; 1 or 0."""


def described() -> list[list[dict[str, str]]]:
    """Return names and units of the columns of the series, states, corrections and laws, for the page."""
    kinds = ((*STATE_COLUMNS, *STATE_EXTRA), CORRECTION_COLUMNS, LAW_COLUMNS)
    return [[{"name": column.name, "unit": column.unit} for column in columns] for columns in kinds]


class Decoder:
    """Vectorised decoder of serialized messages of one type into a table.

    `type_name`: type of numbers only, with a header.
    """

    def __init__(self, type_name: str) -> None:
        self._layout: FixedLayout = fixed_layout(definition(type_name).text, type_name)

    def table(self, messages: Sequence[bytes]) -> npt.NDArray[np.void]:
        """Return records with `time` [s, header stamp] and the message's fields; skips messages of another length."""
        alike = [message for message in messages if len(message) == len(messages[-1])]
        rows = np.frombuffer(b"".join(alike), np.uint8).reshape(len(alike), -1)
        return self._layout.decode(rows, np.zeros(len(alike), np.int64))


def state_values(table: npt.NDArray[np.void]) -> FloatArray:
    """Return the columns STATE_COLUMNS, STATE_EXTRA of states, shape (n, 12)."""
    flags = table["flags"]
    extra = (
        table["reference_force"] - table["load_force"],
        (flags & Flag.ARMED) != 0,
        (flags & Flag.TRIPPED) != 0,
    )
    return np.column_stack([*(table[column.field] * column.scale for column in STATE_COLUMNS), *extra])


def values(columns: Sequence[Column], table: npt.NDArray[np.void]) -> FloatArray:
    """Return these columns of messages, shape (n, columns)."""
    return np.column_stack([table[column.field] * column.scale for column in columns])
