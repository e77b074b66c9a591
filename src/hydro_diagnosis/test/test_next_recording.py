# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import ReferenceSignal, Waveform
from hydro_diagnosis.effects import Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.intervals import all_exclude_neutral, intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import catalog, expected_gain, next_for_law, simulated_recording
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from tests.segments import claim, problem_in, problem_of, record

BENCH = Bench.nominal()
TRUTH = replace(BENCH, supply_pressure=0.985 * BENCH.supply_pressure)
STILL = ReferenceSignal(waveform=Waveform.SINE, amplitude=10.0, offset=0.0, frequency=0.3)


def fits(problem: Problem) -> tuple[Fit, Fit]:
    """The true cause and a rival to it."""
    return fit(problem, [claim("supply_pressure", 0.99)]), fit(problem, [claim("valve_gain", 0.99)])


def told_apart(reference: ReferenceSignal, seed: int) -> float:
    """BIC by which a recording of a bench with a low supply pressure tells it from a low valve gain."""
    recording = simulated_recording(BENCH, reference, truth=TRUTH, seconds=6.0, seed=seed)
    problem = Problem(recording.segments, BENCH)
    true, rival = fits(problem)
    return rival.score - true.score


@pytest.fixture(scope="module")
def undecided() -> Problem:
    return Problem(simulated_recording(BENCH, STILL, truth=TRUTH, seconds=6.0, noise=4.0, seed=5).segments, BENCH)


def test_the_proposed_recording_settles_more_than_a_random_one(undecided: Problem) -> None:
    true, rival = fits(undecided)
    references = catalog(Bench.nominal())
    expected = [expected_gain(undecided, reference, true, rival) for reference in references]
    best = references[int(np.argmax(expected))]
    others = np.random.default_rng(1).choice(len(references), 4, replace=False)
    proposed = told_apart(best, 11)
    assert proposed > np.median([told_apart(references[k], 11) for k in others])
    assert proposed > 10.0


DRAG = 400.0
DRAGGED = replace(
    BENCH, closures=({"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": DRAG}},)
)


def test_a_recording_is_proposed_that_tells_the_two_best_laws_apart() -> None:
    narrow = problem_in(record(DRAGGED, 3, 6.0, Waveform.SINE))
    found = fit(narrow, [Claim(closure(grammar.FORMS["motion", "quadratic drag"], BENCH), {"coefficient": DRAG})])
    proposed = next_for_law(narrow, found)
    assert proposed["separates"][0] == "quadratic drag (motion)" != proposed["separates"][1]
    assert proposed["separates"][1] in proposed["why"] and "%" in proposed["why"]
    assert proposed["reference"] and proposed["expected_gain"] > 10.0


PULLS = {
    "stiffness": {"coefficient": -3200.0},
    "saturating stiffness": {"coefficient": 4000.0, "level": 0.012},
}
"""Two pulls that all but cancel."""


def test_an_interval_holds_no_value_that_the_recordings_rule_out() -> None:
    closures = tuple({"equation": "motion", "form": form, "parameters": values} for form, values in PULLS.items())
    pulled = problem_of(closures=closures)
    laws = [closure(grammar.FORMS["motion", form], BENCH) for form in PULLS]
    found = fit(pulled, [Claim(one, dict(values)) for one, values in zip(laws, PULLS.values(), strict=True)])
    bounds = intervals(pulled, found)
    assert all_exclude_neutral(found.claims, bounds)
    k = 0
    for pull in found.claims:
        without = fit(pulled, tuple(one for one in found.claims if one is not pull))
        assert without.deviance - found.deviance > 1000.0
        for name, value in PULLS[pull.effect.options["form"]].items():
            assert bounds[k].low < value < bounds[k].high, name
            k += 1
