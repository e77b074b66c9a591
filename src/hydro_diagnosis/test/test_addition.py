# SPDX-License-Identifier: Apache-2.0
"""What is spared in fits of terms without a name is exact: summed responses, kept slopes, splines in one pass."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_diagnosis.closure.candidates import laws, tables
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.equation_residuals import split_cached
from hydro_diagnosis.estimation.fit import jacobian
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.bench import Bench

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
