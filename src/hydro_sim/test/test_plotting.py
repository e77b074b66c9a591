# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, Waveform
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.plotting import UNITS, stretches, tracking_plot
from hydro_sim.simulation.offline import Schedule, simulate


def test_every_field_has_a_name_and_a_unit() -> None:
    assert tuple(UNITS) == STATE_FIELDS


def test_stretches_are_the_runs_of_true_values() -> None:
    assert stretches([True, True, False, True, False, False, True]) == [(0, 1), (3, 3), (6, 6)]
    assert stretches([False, False]) == stretches([]) == []


def test_a_run_that_trips_is_drawn_and_leaves_no_style_behind(bench: Bench, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)
    run = simulate(AnalyticPlant(bench), bench, Schedule(reference=sine, gains=(200.0, 15.0), seconds=2.0))
    path = tmp_path / "plots" / "run.svg"
    tracking_plot(run, path, title="a run that trips")
    drawn = path.read_text()
    assert drawn.count('<g id="axes_') == 4
    assert dict(mpl.rcParams) == before
    with pytest.raises(ValueError, match="1 samples"):
        tracking_plot(run[:1], path)
    np.testing.assert_array_equal(run["flags"][-1] & 8, 8)
