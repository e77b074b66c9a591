# SPDX-License-Identifier: Apache-2.0
"""A row's current acts from that row to the next; a logger that writes the one before is told from a bench."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.selection.current_alignment import current_is_late
from hydro_diagnosis.selection.verdict import assess
from hydro_sim.model.bench import Bench


@pytest.mark.parametrize("rows, late", [(1, True), (0, False), (-1, False), (2, False)])
def test_current_that_is_a_row_late_is_noticed(nominal: StateArray, rows: int, late: bool) -> None:
    """Early currents are what a dead time looks like, and two rows late are no convention of any logger."""
    columns = {name: nominal[name].copy() for name in nominal.dtype.names}
    columns["valve_current"] = np.roll(columns["valve_current"], rows)
    segments = checked(RawTable("run", nominal["time"].copy(), None, columns), Bench.nominal()).segments
    problem = Problem(segments, Bench.nominal())
    nothing = fit(problem, ())
    note = current_is_late(problem, assess(problem, nothing, nothing))
    assert (note is not None) == late
    assert note is None or "a row late" in note
