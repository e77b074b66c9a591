# SPDX-License-Identifier: Apache-2.0
"""What is spared in fits of terms without a name is exact: summed responses, kept slopes, splines in one pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.closure.candidates import laws, tables
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.effects.kernels import splined
from hydro_diagnosis.estimation.equation_residuals import split_additive, split_cached
from hydro_diagnosis.estimation.fit import fit, jacobian
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.law_signals import Signals

NAMES = [effect.adapted(Bench.nominal()) for effect in LIBRARY]


@pytest.fixture(scope="module")
def terms(problem: Problem) -> list[Claim]:
    return [*laws(problem), *tables(problem)]


def sized(claim: Claim, random: np.random.Generator) -> Claim:
    amplitudes = {one.name: one.span * random.uniform(-1.0, 1.0) for one in claim.effect.parameters if one.smallest}
    return Claim(claim.effect, {**claim.values, **amplitudes})


def some(terms: list[Claim], random: np.random.Generator, count: int = 3) -> list[Claim]:
    """Terms of kinds drawn alike, few or many as they are, and a name."""
    present = dict.fromkeys(type(one.effect) for one in terms)
    kinds = [[one for one in terms if type(one.effect) is kind] for kind in present]
    drawn = [kinds[random.integers(len(kinds))] for _ in range(count)]
    chosen = {one.effect.label: sized(one, random) for kind in drawn for one in [kind[random.integers(len(kind))]]}
    name = NAMES[random.integers(len(NAMES))]
    return [*chosen.values(), Claim(name, {one.name: one.probes[0] for one in name.parameters})]


def test_residuals_of_terms_that_add_are_those_of_each_as_it_stands(problem: Problem, terms: list[Claim]) -> None:
    """Terms of every equation, drawn at random, beside a name."""
    random, spared = np.random.default_rng(0), 0
    nothing = problem.equations.evaluated(())
    for _ in range(250):
        claims = some(terms, random)
        spared += len(split_cached(claims, ())[0])
        by_sum, as_it_stands = problem.parts(claims), problem.equations.evaluated(claims)
        for key, part in as_it_stands.items():
            np.testing.assert_allclose(by_sum[key] - part, 0.0, atol=1e-8 * np.abs(part - nothing[key]).max() + 1e-9)
    assert spared > 120


def test_behind_a_reading_that_is_no_straight_line_nothing_adds(problem: Problem, terms: list[Claim]) -> None:
    random = np.random.default_rng(1)
    drag = next(one for one in terms if one.effect.label == "closure:motion:quadratic drag")
    curve = next(one for one in terms if one.effect.options["form"] == "quadratic reading of hydraulic_force")
    beside = next(one for one in terms if one.effect.options["form"] == "pick-up of current of hydraulic_force")
    assert [one.effect for one in split_additive([sized(drag, random), sized(beside, random)])[0]] == [drag.effect]
    assert split_additive([sized(drag, random), sized(curve, random)])[0] == []


def test_slopes_that_were_kept_are_those_computed_anew(problem: Problem, terms: list[Claim]) -> None:
    """Each set of claims comes twice, with other amplitudes, on a problem that keeps and on a fresh one."""
    random = np.random.default_rng(2)
    for _ in range(12):
        drawn = some(terms, random)
        for _ in range(2):
            claims = [sized(one, random) if isinstance(one.effect, Closure) else one for one in drawn]
            kept = jacobian(problem, claims, problem.residual(claims))
            fresh = Problem([model.segment for model in problem.models], problem.bench)
            anew = jacobian(fresh, claims, fresh.residual(claims))
            np.testing.assert_allclose(kept, anew, rtol=0.0, atol=1e-5 * np.abs(anew).max(axis=0).max())


def test_a_gauges_table_is_fitted_to_where_fresh_slopes_at_each_step_end(
    record: Callable[..., StateArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gauge of chamber B reads a curve; its table is no term that adds."""
    curve = {"equation": "sensor", "form": "quadratic reading of pressure_b", "parameters": {"coefficient": 1e-8}}
    bench = Bench.nominal()
    states = record(replace(bench, closures=(curve,)), 3)
    columns = {field: states[field].copy() for field in STATE_FIELDS}
    segment = checked(RawTable("run", states["time"].copy(), None, columns), bench).segments[0]
    problem = Problem([segment], bench)
    (table,) = [one for one in tables(problem) if one.effect.label == "closure:sensor:table over pressure_b"]
    nothing, spared = fit(problem, ()), fit(problem, [table])
    monkeypatch.setattr("hydro_diagnosis.estimation.fit.STRAIGHT", 0.0)
    anew = fit(Problem([segment], bench), [table])
    assert nothing.deviance - anew.deviance > 1000.0
    assert spared.deviance == pytest.approx(anew.deviance, abs=0.2)


def test_a_table_in_one_pass_has_its_values() -> None:
    random = np.random.default_rng(3)
    for table in grammar.TABLES[:3]:
        numbers = [-0.4, 0.7, *random.normal(size=12)]
        over = np.concatenate([random.uniform(-1.0, 1.5, 500), [-0.4, 0.7]])
        at = Signals(position=over, velocity=over, pressure_a=over, pressure_b=np.zeros(502), memory=over)
        values = splined(np.asarray(table.over(at)), *numbers[:2], np.array(numbers[2:]))
        factor = table.factor.shape(at) if table.factor else 1.0
        np.testing.assert_allclose(values * factor, table.value(at, None, numbers), rtol=1e-12, atol=1e-14)
    assert np.isnan(splined(np.array([np.nan]), -0.4, 0.7, np.ones(12))).all()
