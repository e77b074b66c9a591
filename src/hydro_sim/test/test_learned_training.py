# SPDX-License-Identifier: Apache-2.0
"""Runs do not cross gaps; schedules stay within their limits."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import Flag
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import drawn as schedule
from hydro_sim.files import recordings


@pytest.fixture(scope="module")
def recording():
    return record_offline(profile("default"), schedule.draw(24.0, 5), seed=5)


def test_runs_do_not_cross_gaps_or_faults(recording):
    states = np.delete(recording.states, [5000, 5001])
    states["flags"][12000] |= np.uint32(Flag.SENSOR_FAULT)
    states["load_force"][15000] = np.nan
    found = recordings.runs("r", states)
    assert [(run.first, len(run)) for run in found] == [
        (0, 5000),
        (5000, 7000),
        (12001, 2999),
        (15001, len(states) - 15001),
    ]
