# SPDX-License-Identifier: Apache-2.0
"""Laws with a state are found with both of their numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.closure.selection import closures
from hydro_diagnosis.effects.kernels import along
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.selection.verdict import assess
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()


def _problem(states: StateArray) -> Problem:
    table = RawTable("run", states["time"].copy(), None, {field: states[field].copy() for field in STATE_FIELDS})
    return Problem([checked(table, BENCH).segments[0]], BENCH)


def test_a_path_element_follows_direction_and_distance_alone() -> None:
    back_and_forth = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.5, 20)])
    force = along(back_and_forth, 10.0, np.ones(70))
    assert force[49] == pytest.approx(1.0 - np.exp(-10.0))
    assert force[-1] == pytest.approx(-1.0 + (force[49] + 1.0) * np.exp(-5.0))
    slow = np.repeat(back_and_forth, 3)
    np.testing.assert_allclose(along(slow, 10.0, np.ones(210))[2::3], force)


@pytest.mark.parametrize(
    ("equation", "form", "coefficient", "number", "value"),
    [
        ("actuation", "hysteresis", -3e-4, "path", 4e-4),
        ("load", "hysteresis", 9.0, "path", 2e-3),
        ("pressure_a", "creeping volume", 2e-13, "time", 0.15),
    ],
)
def test_what_a_bench_remembers_is_found_with_both_numbers(
    record: Callable[..., StateArray], equation: str, form: str, coefficient: float, number: str, value: float
) -> None:
    parameters = {"coefficient": coefficient, number: value}
    truth = replace(BENCH, closures=({"equation": equation, "form": form, "parameters": parameters},))
    problem = _problem(record(truth, 3))
    nothing = fit(problem, ())
    law = next(closures(problem, assess(problem, nothing, nothing)))
    assert [claim.effect.label for claim in law.fit.claims] == [f"closure:{equation}:{form}"]
    assert not noticeable(problem, law.fit.residual)
    amplitude, shape = intervals(problem, law.fit)
    assert amplitude.value == pytest.approx(coefficient, rel=0.05)
    assert shape.value == pytest.approx(value, rel=0.1)
