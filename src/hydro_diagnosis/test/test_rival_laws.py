# SPDX-License-Identifier: Apache-2.0
"""The recording that is proposed for a closure tells its law from the next best one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design.next_recording import catalog
from hydro_diagnosis.experiment_design.rival_laws import next_for_law
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
DRAG = 400.0
TRUTH = replace(
    BENCH, closures=({"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": DRAG}},)
)


def problem_of(states: StateArray) -> Problem:
    table = RawTable("run", states["time"].copy(), None, {name: states[name].copy() for name in STATE_FIELDS})
    return Problem(checked(table, BENCH).segments, BENCH)


def law(form: str, coefficient: float) -> Claim:
    return Claim(closure(grammar.ALL["motion", form], BENCH), {"coefficient": coefficient})


def told_apart(reference: ReferenceSignal, found: Fit, rival: Fit) -> float:
    """BIC by which 6 s of a bench with the drag tell the law from the rival."""
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=6.0)
    problem = problem_of(simulate(AnalyticPlant(TRUTH), BENCH, schedule, seed=11))
    return score(problem, fit(problem, rival.claims)) - score(problem, fit(problem, found.claims))


@pytest.fixture(scope="module")
def dragged(record: Callable[..., StateArray]) -> Problem:
    return problem_of(record(TRUTH, 3, 6.0))


def test_the_proposed_recording_tells_the_two_best_laws_apart_better_than_most(dragged: Problem) -> None:
    found = fit(dragged, [law("quadratic drag", DRAG)])
    proposed = next_for_law(dragged, found)
    assert proposed is not None
    assert proposed["separates"][0] == "quadratic drag (motion)" != proposed["separates"][1]
    assert proposed["separates"][1] in proposed["why"] and "%" in proposed["why"]
    form, _, place = proposed["separates"][1].partition(" (")
    effect = closure(grammar.ALL[place.rstrip(")"), form], BENCH)
    rival = fit(dragged, [Claim(effect, {one.name: one.probes[0] for one in effect.parameters})])
    best = next(
        one for one in catalog()
        if (one.waveform.name.lower(), one.amplitude, one.offset, one.frequency)
        == tuple(proposed["reference"][key] for key in ("waveform", "amplitude", "offset", "frequency"))
    )  # fmt: skip
    others = np.random.default_rng(2).choice(list(catalog()), 3, replace=False)  # type: ignore[arg-type]
    apart = told_apart(best, found, rival)
    assert apart > 10.0
    assert apart > np.median([told_apart(one, found, rival) for one in others])


def test_a_law_without_a_rival_and_a_fit_without_a_law_need_no_recording(dragged: Problem) -> None:
    assert next_for_law(dragged, fit(dragged, ())) is None
    states = simulate(
        AnalyticPlant(TRUTH),
        BENCH,
        Schedule(
            reference=ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=2.0), gains=(60.0, 10.0),
            seconds=6.0,
        ),
        seed=4,
    )  # fmt: skip
    fast = problem_of(states)
    slow = fit(fast, [law("quadratic drag", DRAG)])
    assert slow.deviance < fit(fast, [law("cubic drag", 1e3)]).deviance
