# SPDX-License-Identifier: Apache-2.0
"""The screen's closed form against cross-validation set by set, and its toll for the number of columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.closure.evidence import HeldOutBlocks
from hydro_diagnosis.closure.screen import Screen, laws, threshold
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model.bench import Bench
from hydro_sim.model.grammar.composition import divided

BENCH = Bench.nominal()


@pytest.fixture(scope="module")
def carried(record: Callable[..., StateArray]) -> Problem:
    """A rod that carries oil out of chamber B, and a spring that is softer than believed."""
    closure = {"equation": "pressure_b", "form": "carried oil, outwards", "parameters": {"coefficient": 0.03}}
    states = record(replace(BENCH, closures=(closure,), spring_stiffness=0.97 * BENCH.spring_stiffness), 3)
    table = RawTable("run", states["time"].copy(), None, {field: states[field].copy() for field in STATE_FIELDS})
    return Problem([checked(table, BENCH).segments[0]], BENCH)


def test_what_a_law_gains_is_that_of_cross_validation_and_of_its_own_residual(carried: Problem) -> None:
    """Of laws of each equation, beside a name: exact columns, set by set, against responses in closed form."""
    softer = next(one for one in LIBRARY if one.label == "spring_stiffness").adapted(BENCH)
    base = fit(carried, (Claim(softer, {softer.parameters[0].name: softer.parameters[0].neutral}),))
    tried = [one for one in laws(carried) if one.effect.options["form"] in FORMS]
    gains, _ = Screen(carried, base, tried).gains(base)
    wanted = []
    for one in tried:
        (size,) = [parameter for parameter in one.effect.parameters if parameter.smallest > 0.0]
        probe = Claim(one.effect, {**one.values, size.name: 1e-3 * size.span})
        column = carried.residual((*base.claims, probe)) - base.residual
        wanted.append(-HeldOutBlocks(carried, base, [column[:, None]]).deviance((0,)))
    wanted = np.array(wanted) + HeldOutBlocks(carried, base, ()).deviance(())
    assert {one.effect.options["form"] for one in tried} == set(FORMS)
    np.testing.assert_allclose(gains, wanted, rtol=0.02, atol=3.0)
    assert tried[int(np.argmax(gains))].effect.options["form"] == "carried oil, outwards"


FORMS = ("carried oil, outwards", "quadratic leak", "pick-up of position of load_force", "drag, inwards",
         "damping", "gain, to one side", "quadratic reading of pressure_b", "pick-up of current of pressure_a",
         "pick-up of position of pressure_b")  # fmt: skip


def test_the_threshold_pays_for_the_number_of_columns() -> None:
    """The best of n columns of noise gains some 2 ln n."""
    assert threshold(153) == pytest.approx(30.0, abs=0.1)
    assert threshold(3000) - threshold(30) == pytest.approx(2.0 * np.log(100.0))


@pytest.mark.parametrize(
    ("unit", "others", "left"),
    [
        ("N", ("m/s", "-"), "N s/m"),
        ("m3/s", ("Pa", "A"), "m3/s/Pa/A"),
        ("m3/s", ("m3/s", "-"), "-"),
        ("-", ("A2", "-"), "1/A2"),
        ("N", ("m2/s2", "m"), "N s2/m3"),
    ],
)
def test_a_coefficient_has_what_is_left_of_the_equations_unit(unit: str, others: tuple[str, ...], left: str) -> None:
    assert divided(unit, *others) == left
