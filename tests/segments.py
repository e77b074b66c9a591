# SPDX-License-Identifier: Apache-2.0
"""A simulated run as the diagnosis reads it."""

from __future__ import annotations

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench


def segment(states: StateArray, name: str = "run") -> Segment:
    """All fields of the nominal bench's run."""
    columns = {field: states[field].copy() for field in STATE_FIELDS}
    return checked(RawTable(name, states["time"].copy(), None, columns), Bench.nominal()).segments[0]
