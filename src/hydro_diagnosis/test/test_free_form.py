# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.free_form import free_forms
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.bench import Bench


def test_free_form_of_viscous_friction_has_its_place_and_slope(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(viscous_friction=90.0)
    best = free_forms(problem, fit(problem, ()))[0]
    assert (best.equation, best.variable) == ("motion", "velocity")
    inner = slice(4, -4)
    slope = np.polyfit(best.knots[inner], best.values[inner], 1)[0]
    assert abs(slope) == pytest.approx(90.0 - Bench.nominal().viscous_friction, rel=0.05)


def test_ripple_that_no_cause_makes_is_called_unknown(
    record: Callable[..., StateArray], frame: Callable[[StateArray], pd.DataFrame], tmp_path: Path
) -> None:
    paths = []
    for seed in (5, 6):
        states = record(Bench.nominal(), seed, seconds=8.0)
        states["load_force"] += 8.0 * np.sin(states["piston_position"] * (2.0 * np.pi / 3e-3))
        paths.append(tmp_path / f"run{seed}.csv")
        frame(states).to_csv(paths[-1], index=False)
    report = diagnose(paths[:1], holdout=paths[1:]).report
    assert report.verdict == "unknown"
    assert report.effects == []
    assert report.remainder is not None and "position" in report.remainder["depends_on"]
