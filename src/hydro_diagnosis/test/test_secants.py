# SPDX-License-Identifier: Apache-2.0
"""Fits by secants end where fits in full do, for fewer residuals; candidates that wait are tried in the end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import Fit, fit, pack, with_one_more, without_one
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.bench import Bench

ADAPTED = [effect.adapted(Bench.nominal()) for effect in LIBRARY]


def claim(name: str) -> Claim:
    effect = next(one for one in ADAPTED if one.id == name)
    return Claim(effect, {one.name: one.probes[0] for one in effect.parameters})


@pytest.fixture(scope="module")
def worn(problem_of: Callable[..., Problem]) -> Problem:
    return problem_of(spring_stiffness=18500.0, moving_mass=1.6, bulk_modulus=1.2e9)


@pytest.fixture(scope="module")
def found(worn: Problem) -> Fit:
    return fit(worn, (claim("spring_stiffness"), claim("bulk_modulus")))


def counted(problem: Problem, run: Callable[[], Fit]) -> tuple[Fit, int]:
    before = problem.evaluations
    return run(), problem.evaluations - before


def test_one_claim_more_is_fitted_like_all_anew(worn: Problem, found: Fit) -> None:
    more, few = counted(worn, lambda: with_one_more(worn, found, claim("moving_mass")))
    anew, many = counted(worn, lambda: fit(worn, (*found.claims, claim("moving_mass"))))
    assert more.deviance == pytest.approx(anew.deviance, abs=0.5)
    np.testing.assert_allclose(pack(more.claims)[1], pack(anew.claims)[1], rtol=1e-3)
    assert 2 * few < many


def test_one_claim_less_is_fitted_like_all_anew(worn: Problem, found: Fit) -> None:
    full = fit(worn, (*found.claims, claim("moving_mass")))
    less, few = counted(worn, lambda: without_one(worn, full, full.claims[-1]))
    anew, many = counted(worn, lambda: fit(worn, full.claims[:-1]))
    assert [one.effect.id for one in less.claims] == ["spring_stiffness", "bulk_modulus"]
    assert less.deviance == pytest.approx(anew.deviance, abs=0.5)
    assert few < many
