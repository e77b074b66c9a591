# SPDX-License-Identifier: Apache-2.0
"""A wrong value is constant: what follows the state, or another law, does not get its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis.effects import CANDIDATES, Claim, Effect
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.search import Outcome, Search
from hydro_diagnosis.selection.verdict import assess, without_varying
from hydro_diagnosis.stages.reporting import describe
from hydro_sim.model.bench import Bench
from tests.segments import problem_of

BENCH = Bench.nominal()
EFFECTS = {effect.label: effect.adapted(BENCH) for effect in CANDIDATES}
BIAS, BULK, HOSES = "load_cell_bias:hydraulic_force", "bulk_modulus", "hoses_that_widen"


def claim(label: str) -> Claim:
    effect: Effect = EFFECTS[label]
    return Claim(effect, {one.name: one.probes[0] for one in effect.parameters})


def searched(problem: Problem) -> Outcome:
    return Search(problem, list(EFFECTS.values())).run()


@pytest.fixture(scope="module")
def altered(nominal: StateArray) -> Callable[[Mapping[str, FloatArray]], Problem]:
    """The nominal recording with something added to its channels."""

    def build(added: Mapping[str, FloatArray]) -> Problem:
        channels = {name: nominal[name].copy() for name in ("hydraulic_force", "load_force", "pressure_a", "pressure_b",
                                                            "piston_position", "valve_current")}  # fmt: skip
        for name, signal in added.items():
            channels[name] = channels[name] + signal
        return Problem([Segment("run", 0.0, 1e-3, channels)], BENCH)

    return build


def test_bias_that_follows_a_pressure_is_no_bias(nominal: StateArray, altered: Callable[..., Problem]) -> None:
    problem = altered({"hydraulic_force": 3e-6 * nominal["pressure_a"]})
    found = fit(problem, [claim(BIAS)])
    judged = np.isin(problem.layout.channel, (2, 4))
    assert without_varying(problem, found, judged, frozenset()).claims == ()
    assert without_varying(problem, found, judged, frozenset({"load_cell_bias"})) is found


def test_bias_beside_something_else_stays(nominal: StateArray, altered: Callable[..., Problem]) -> None:
    hum = 5.0 * np.sin(2.0 * np.pi * 9.0 * nominal["time"])
    problem = altered({"hydraulic_force": 20.0 + hum})
    found = fit(problem, [claim(BIAS)])
    judged = np.isin(problem.layout.channel, (2, 4))
    assert [one.effect.label for one in without_varying(problem, found, judged, frozenset()).claims] == [BIAS]


def hoses(compliance: float) -> dict[str, float]:
    """Both dead volumes as wide hoses make them, from the docstring's formula at a mean pressure."""
    more = compliance * (BENCH.bulk_modulus + 7e6)
    return {"dead_volume_a": BENCH.dead_volume_a + more, "dead_volume_b": BENCH.dead_volume_b + more}


def test_hoses_that_widen_are_no_wrong_bulk_modulus() -> None:
    problem = problem_of(**hoses(1.1e-14))
    outcome = searched(problem)
    assert [one.effect.label for one in outcome.fit.claims] == [HOSES]
    found = assess(problem, outcome.fit, outcome.nothing)
    assert found.verdict == "unknown"
    assert found.fit.claims == ()
    assert found.dropped[0].values["compliance"] == pytest.approx(1.1e-14, rel=0.02)
    assert {place.equation for place in found.remainder} <= {"pressure_a", "pressure_b"}


def test_wrong_bulk_modulus_is_no_hoses() -> None:
    problem = problem_of(bulk_modulus=0.93 * BENCH.bulk_modulus)
    outcome = searched(problem)
    assert [one.effect.label for one in outcome.fit.claims] == [BULK]
    rival = fit(problem, [claim(HOSES)])
    assert rival.score > outcome.fit.score + 100.0
    assert HOSES in [one.claims[-1].effect.label for one in outcome.rivals[BULK]]
    judgement = assess(problem, outcome.fit, outcome.nothing)
    (effect,) = describe(problem, problem, outcome, judgement, intervals(problem, judgement.fit))
    assert HOSES not in [one.id for one in effect.rivals]  # the table has no such id
    (alike,) = effect.look_alikes
    assert "hoses that widen" in alike.likeness
    assert alike.distinguishable and alike.delta_bic > 100.0


@pytest.mark.study
def test_other_causes_beside_hoses_keep_name_and_size() -> None:
    problem = problem_of(**hoses(3e-14), spring_stiffness=19000.0)
    outcome = searched(problem)
    found = assess(problem, outcome.fit, outcome.nothing)
    assert found.verdict == "partly_explained"
    (spring,) = found.fit.claims
    assert spring.effect.id == "spring_stiffness"
    assert spring.values["ratio"] == pytest.approx(0.95, abs=1e-3)
