# SPDX-License-Identifier: Apache-2.0
"""Causes are found, named and sized; a wrong value is constant: what follows the state does not get its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import FloatArray, Waveform
from hydro_diagnosis import diagnose
from hydro_diagnosis.closure.selection import best_closure
from hydro_diagnosis.effects import CANDIDATES, LIBRARY, Effect, EffectHypothesis
from hydro_diagnosis.effects.base import CHANNELS
from hydro_diagnosis.estimation.budget import Budget
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import is_significant
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unknown_parameters import estimated_claims
from hydro_diagnosis.judge import assess, retain_claims
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.selection.search import Search, SearchOutcome, SearchSettings
from hydro_diagnosis.stages.naming import StageResult
from hydro_diagnosis.stages.reporting import effect_reports
from hydro_sim.model.bench import Bench
from tests.segments import claim, problem_in, problem_of, record

NOMINAL = Bench.nominal()
ADAPTED = [effect.adapted(NOMINAL) for effect in LIBRARY]
EFFECTS = [effect.adapted(NOMINAL) for effect in CANDIDATES]


def search(problem: Problem, effects: Sequence[Effect] = ADAPTED) -> SearchOutcome:
    return Search(problem, list(effects)).run()


def test_nothing_is_claimed_where_nothing_is_missing(problem: Problem) -> None:
    outcome = search(problem)
    squares = problem.mean_squares(outcome.baseline_fit.residual)
    assert all(0.75 < square < 1.25 for square in squares.values()), squares
    assert outcome.fit.claims == ()
    assert best_closure(problem, outcome.baseline_fit) is None


@pytest.mark.parametrize(
    ("key", "factor", "expected", "tolerance"),
    [("moving_mass", 1.5, 0.6, 0.03), ("spring_stiffness", 0.95, 0.95, 0.001), ("bulk_modulus", 0.8, 0.8, 0.002)],
)
def test_wrong_value_is_named_and_sized(key: str, factor: float, expected: float, tolerance: float) -> None:
    """`expected`: of the only parameter of the cause of this name."""
    (named,) = search(problem_of(**{key: getattr(NOMINAL, key) * factor})).fit.claims
    assert named.effect.id == key and [*named.values.values()] == pytest.approx([expected], rel=tolerance)


def problem_with(causes: dict[str, tuple[float, ...]]) -> Problem:
    claims = [claim(label, *sizes) for label, sizes in causes.items()]
    return problem_in(record(corrected_bench(NOMINAL, claims), 3, seconds=8.0))


@pytest.mark.parametrize(
    ("causes", "tolerance"),
    [
        ({"valve_deadband": (8e-4,), "valve_gain": (0.9,), "leakage_external:a": (3e-14,)}, 0.02),
        ({"valve_lag": (90.0, 0.9)}, 0.05),
    ],
)
def test_a_hard_dead_band_is_no_soft_one_and_a_lag_of_second_order_no_dead_time(
    causes: dict[str, tuple[float, ...]], tolerance: float
) -> None:
    """A soft dead band comes first, as it takes the form of band and gain; neither leak nor gain is left beside it."""
    found = {one.effect.label: tuple(one.values.values()) for one in search(problem_with(causes)).fit.claims}
    assert found == {label: pytest.approx(sizes, rel=tolerance, abs=0.0) for label, sizes in causes.items()}


@pytest.mark.parametrize(
    "pair",
    [
        {"valve_offset": (2e-4,), "valve_gain": (0.9,)},
        {"valve_gain": (0.807,), "valve_deadband": (1.3e-4,)},
        {"valve_gain_asymmetry": (0.935,), "leakage_internal": (1.97e-13,)},
    ],
)
def test_two_causes_that_explain_little_alone_are_found_as_a_pair(pair: dict[str, tuple[float, ...]]) -> None:
    """Step by step others come first that mimic both: single edges, an asymmetry, a lopsided dead band."""
    found = {one.effect.label: [*one.values.values()] for one in search(problem_with(pair)).fit.claims}
    assert found == {label: pytest.approx(sizes, rel=3e-3, abs=0.0) for label, sizes in pair.items()}


def test_four_edges_that_move_alike_are_one_offset_and_one_gain() -> None:
    """The spool at u + u_0 opens two edges earlier and two later."""
    problem = problem_with({"valve_gain": (0.95,), "valve_offset": (-2e-4,)})
    sides = {"pa": 2e-4, "at": -2e-4, "pb": -2e-4, "bt": 2e-4}
    single = fit(problem, [claim(f"valve_edge:{edge}", overlap, 0.95) for edge, overlap in sides.items()])
    assert not problem.has_excess(single.residual)
    outcome = Search(problem, ADAPTED)._common_to_edges(SearchOutcome(problem, single, fit(problem, ())))
    found = {one.effect.label: [*one.values.values()] for one in outcome.fit.claims}
    assert found == {"valve_gain": pytest.approx([0.95], rel=1e-3), "valve_offset": pytest.approx([-2e-4], rel=0.01)}


@pytest.mark.parametrize("half_width", [4e-4, 1.5e-3])
def test_one_slow_sine_tells_overlap_lag_and_leak_apart(half_width: float) -> None:
    """A lopsided overlap and another leak leave so little that the lag seemed to mend their form."""
    sizes = {"valve_deadband": (half_width,), "valve_lag": (110.0, 1.2), "leakage_internal": (1e-13,),
             "friction_coulomb": (12.0,)}  # fmt: skip
    bench = corrected_bench(NOMINAL, [claim(label, *given) for label, given in sizes.items()])
    outcome = search(problem_in(record(bench, 3, 6.0, Waveform.SINE, 200.0, frequency=0.5)))
    found = {one.effect.label: [*one.values.values()] for one in outcome.fit.claims}
    assert found.keys() == sizes.keys() and not outcome.problem.has_excess(outcome.fit.residual)
    assert found["valve_deadband"] + found["leakage_internal"] == pytest.approx([half_width, 1e-13], rel=1e-3, abs=0.0)


@pytest.mark.study
def test_what_only_mends_a_form_hides_no_cause_elsewhere() -> None:
    """The lag is a small part of a wide overlap's effect, and pays in full only beside the leak."""
    causes = {"valve_deadband": (3e-3,), "supply_pressure": (0.75,), "valve_lag": (90.0, 0.9),
              "leakage_internal": (2e-12,), "friction_coulomb": (20.0,)}  # fmt: skip
    assert {one.effect.id for one in search(problem_with(causes)).fit.claims} == set(causes)


def test_a_richer_form_is_named_only_where_it_pays_for_its_parameter() -> None:
    """15.0 and 15.1 N: the second number gains 14 of BIC, which errors of the residuals' own reach."""
    dry, directed = "friction_coulomb", "friction_coulomb:directional"
    outcome = search(problem_with({directed: (15.0, 15.1)}))
    assert [one.effect.label for one in outcome.fit.claims] == [dry]
    richer = outcome.fit.score - fit(outcome.problem, [claim(directed, 15.0, 15.0)]).score
    assert 2.0 < richer < SearchSettings().threshold  # else this shows nothing
    (found,) = search(problem_with({directed: (15.0, 15.3)})).fit.claims
    assert found.effect.label == directed and found.values["force_negative"] == pytest.approx(15.3, abs=0.1)


@pytest.mark.parametrize(("square", "remains"), [(1.45, set(CHANNELS[:4])), (1.7, set(CHANNELS))])
def test_what_remains_is_judged_by_how_many_residuals_tell(problem: Problem, square: float, remains: set[str]) -> None:
    """12 s: 2300 residuals in most channels, but 117 means over 100 ms, whose mean square chance brings to 1.4."""
    for index, name in enumerate(CHANNELS):
        residual = np.where(problem.layout.channel == index, square**0.5, 1.0)
        assert problem.has_excess(residual) == (name in remains), name


def test_a_search_that_ends_early_says_why() -> None:
    worn_out = problem_of(
        moving_mass=1.6, viscous_friction=90.0, spring_stiffness=18500.0, spring_rest_position=0.0405,
        bulk_modulus=1.2e9, supply_pressure=15.2e6, dead_volume_a=2.2e-4, area_ratio=0.58,
    )  # fmt: skip
    for settings, why in ({"max_claims": 2}, "2 causes at most"), ({"effort": 150}, "150 evaluations"):
        outcome = Search(worn_out, ADAPTED, SearchSettings(**settings)).run()
        assert why in outcome.stop_reason
        assert worn_out.has_excess(outcome.fit.residual)


def test_budget_of_work_ends_it_with_the_best_answer_so_far(worn: list[Path]) -> None:
    """Counted, not timed: twice the same. The soft spring is found by then, or is not, and the report is whole."""
    reports = [diagnose(worn[:2], holdout=worn[2:], seconds=0.05).report for _ in range(2)]
    first, again = (replace(report, seconds=0.0).to_json() for report in reports)
    assert first == again and reports[0].seconds > 0.0
    assert any("budget of work (0.05 s" in note for note in reports[0].data_quality)
    assert reports[0].verdict in ("explained", "partly_explained", "unknown")


def test_budget_grows_with_what_is_recorded_unless_it_is_chosen() -> None:
    for budget, samples, seconds in (Budget(), 20_000, 24.0), (Budget(), 600_000, 240.0), (Budget(5.0), 600_000, 5.0):
        budget.allow(samples)
        assert budget.seconds == seconds


def sized(effect: Effect, **values: float) -> EffectHypothesis:
    return EffectHypothesis(effect, {**{one.name: one.start_values[0] for one in effect.parameters}, **values})


def test_amplitude_at_a_bound_of_physics_or_too_small_to_matter_is_not_claimed() -> None:
    for effect in (one for one in ADAPTED if one.amplitudes):
        for one in effect.amplitudes:
            for bound in {one.low, one.high} - {one.neutral}:
                assert not is_significant(sized(effect, **{one.name: bound})), effect.label
        small = {one.name: one.neutral + 0.9 * one.smallest_reported for one in effect.amplitudes}
        assert not is_significant(sized(effect, **small)), effect.label
        assert is_significant(sized(effect)), effect.label


def test_effect_of_shapes_alone_is_not_claimed_where_it_is_none() -> None:
    """The stiffest bristles are dry friction, the quickest lag is none; seen claimed, with evidence of 1000 BIC."""
    for effect in (one for one in ADAPTED if not one.amplitudes):
        absent, first = {one.name: one.neutral for one in effect.parameters}, effect.parameters[0]
        for share, claimed in ((1.0, False), (0.97, False), (0.5, True)):
            sizes = {**absent, first.name: share * first.neutral}
            assert is_significant(sized(effect, **sizes)) == claimed, effect.label


def test_a_number_that_was_given_is_estimated_beside_the_causes() -> None:
    """Seen: what 0.4 mA of overlap do was taken for oil ten times as stiff, and the overlap not named."""
    causes = {"valve_deadband": (2e-3,), "valve_lag": (70.0, 0.8), "leakage_internal": (1e-12,)}
    numbers = estimated_claims(NOMINAL, ["bulk_modulus"])
    found = Search(problem_with(causes).with_estimated(numbers), ADAPTED, given=True).run().fit
    assert {one.effect.id for one in found.cause_claims} == set(causes)
    assert found.claims[0].effect.estimated and found.claims[0].values["ratio"] == pytest.approx(1.0, abs=0.02)


HOSES = "hoses_that_widen"


@pytest.mark.study
def test_hoses_that_widen_are_no_wrong_bulk_modulus() -> None:
    """Both dead volumes as wide hoses make them, from the docstring's formula at a mean pressure."""
    more = 1.1e-14 * (NOMINAL.bulk_modulus + 7e6)
    problem = problem_of(dead_volume_a=NOMINAL.dead_volume_a + more, dead_volume_b=NOMINAL.dead_volume_b + more)
    outcome = search(problem, EFFECTS)
    assert [one.effect.label for one in outcome.fit.claims] == [HOSES]
    kept, _ = retain_claims(problem, problem, outcome.fit, outcome.baseline_fit)
    found = assess(problem, outcome.fit, kept, outcome.baseline_fit, problem, {}, {"holdout": {}, "free_run": {}})
    assert found.verdict == "unknown" and found.fit.claims == ()
    assert found.dropped[0].values["compliance"] == pytest.approx(1.1e-14, rel=0.02, abs=0.0)
    assert {place.equation for place in found.remainder} <= {"pressure_a", "pressure_b"}


def test_wrong_bulk_modulus_is_no_hoses() -> None:
    problem = problem_of(bulk_modulus=0.93 * NOMINAL.bulk_modulus)
    outcome = search(problem, EFFECTS)
    assert [one.effect.label for one in outcome.fit.claims] == ["bulk_modulus"]
    rival = fit(problem, [claim(HOSES)])
    assert rival.score > outcome.fit.score + 100.0
    assert HOSES in [one.claims[-1].effect.label for one in outcome.rivals["bulk_modulus"]]
    kept, bounds = retain_claims(problem, problem, outcome.fit, outcome.baseline_fit)
    judgement = assess(problem, outcome.fit, kept, outcome.baseline_fit, problem, {}, {"holdout": {}, "free_run": {}})
    (effect,) = effect_reports(
        StageResult(problem=problem, outcome=outcome, assessment=judgement, bounds=bounds, holdout=problem,
                    simulations={}, holdout_report={}, accounted={})
    )  # fmt: skip
    assert HOSES not in [one.id for one in effect.rivals]  # the table has no such id
    (alike,) = effect.look_alikes
    assert "hoses that widen" in alike.likeness
    assert alike.distinguishable and alike.delta_bic > 100.0


def test_parameter_at_whose_step_the_model_runs_away_stays(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, start = problem.residual, claim("friction_coulomb", 5.0)

    def runs_away(claims: Sequence[EffectHypothesis]) -> FloatArray:
        beyond = claims[0].values["force"] > start.values["force"]
        return np.full_like(whole(claims), np.inf) if beyond else whole(claims)

    monkeypatch.setattr(problem, "residual", runs_away)
    found = fit(problem, (start,))
    assert found.claims[0].values == start.values and np.isfinite(found.deviance)
