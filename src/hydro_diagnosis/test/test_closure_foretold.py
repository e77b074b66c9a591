# SPDX-License-Identifier: Apache-2.0
"""Where something remains, a name stays beside laws only if it does not make the held-out recordings worse."""

from __future__ import annotations

from collections.abc import Callable

from hydro_diagnosis.closure.admission import without_harmful_names
from hydro_diagnosis.closure.growth import ClosureFit
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

WEAKER = {"id": "valve_gain", "parameters": {"ratio": 0.94}}
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 900.0}}
RING = {"equation": "pressure", "form": "leak, since a reversal", "parameters": {"coefficient": 3e-13, "path": 5e-4}}


def closed_by(problem: Problem) -> ClosureFit:
    """A weaker valve and drag fitted to a recording."""
    weaker = next(one for one in LIBRARY if one.label == "valve_gain").adapted(Bench.nominal())
    drag = closure(grammar.ALL["motion", "quadratic drag"], problem.bench)
    claims = [Claim(weaker, {"ratio": 0.95}), Claim(drag, drag.nothing()[0])]
    return ClosureFit(fit(problem, claims), "law", 1.0, problem)


def labels(closed: ClosureFit) -> set[str]:
    return {claim.effect.label for claim in closed.fit.claims}


def test_a_name_that_the_held_out_recordings_do_not_have_goes(problem_of: Callable[..., Problem]) -> None:
    closed = closed_by(problem_of(effects=(WEAKER,), closures=(DRAG, RING)))
    assert noticeable(closed.problem, closed.fit.residual)
    same, without = problem_of(effects=(WEAKER,), closures=(DRAG, RING)), problem_of(closures=(DRAG, RING))
    assert without_harmful_names(closed, same) is closed
    assert labels(without_harmful_names(closed, without)) == {"closure:motion:quadratic drag"}


def test_where_nothing_remains_all_names_stay(problem_of: Callable[..., Problem]) -> None:
    closed = closed_by(problem_of(effects=(WEAKER,), closures=(DRAG,)))
    assert not noticeable(closed.problem, closed.fit.residual)
    assert without_harmful_names(closed, problem_of(closures=(DRAG,))) is closed
