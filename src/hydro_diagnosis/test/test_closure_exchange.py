# SPDX-License-Identifier: Apache-2.0
"""After growth each claim is exchanged: a law for one that does better, a name for one of fewer numbers."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hydro_diagnosis.closure.growth import ForwardSelection, _exchanged
from hydro_diagnosis.closure.screen import Screen, laws
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import fit, noticeable, score
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

WEAKER = {"id": "valve_gain", "parameters": {"ratio": 0.94}}
SATURATED = {"equation": "actuation", "form": "rounded gain", "parameters": {"coefficient": -1.0, "level": 0.015}}


def test_a_name_is_exchanged_for_one_that_does_as_well_with_fewer_numbers(problem_of: Callable[..., Problem]) -> None:
    """A motor that saturates behind a weaker valve: an overlap that opens softly beside the same law fits as well."""
    problem = problem_of(effects=(WEAKER,), closures=(SATURATED,))
    names = [effect.adapted(Bench.nominal()) for effect in LIBRARY if effect.named]
    overlap = next(name for name in names if name.label == "valve_deadband:soft")
    law = closure(grammar.ALL["actuation", "rounded gain"], problem.bench)
    claims = [
        Claim(overlap, {"half_width": 3.7e-4, "softness": 4.4e-3}),
        Claim(law, {"coefficient": -0.9, "level": 0.013}),
    ]
    found = fit(problem, claims, iterations=24)
    screen = Screen(problem, fit(problem, ()), laws(problem))
    better = _exchanged(problem, found, ForwardSelection(screen), names)
    values = {claim.effect.label: claim.values for claim in better.claims}
    assert not noticeable(problem, found.residual) and score(problem, better) < score(problem, found)
    assert set(values) == {"valve_gain", "closure:actuation:rounded gain"}
    assert values["valve_gain"]["ratio"] == pytest.approx(0.94, abs=2e-3)
