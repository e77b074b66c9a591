# SPDX-License-Identifier: Apache-2.0
"""The recording that is proposed for a closure tells its law from the next best one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_bridge.signals import STATE_FIELDS, ReferenceSignal, StateArray, Waveform
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import Fit, fit, score
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import catalog, next_for_law, rival_law
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
DRAG = 400.0
TRUTH = replace(
    BENCH, closures=({"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": DRAG}},)
)


def driven(reference: ReferenceSignal, seed: int) -> StateArray:
    """6 s of the bench with the drag."""
    schedule = Schedule(reference=reference, gains=(60.0, 10.0), seconds=6.0)
    return simulate(AnalyticPlant(TRUTH), BENCH, schedule, seed=seed)


def problem_of(*runs: StateArray) -> Problem:
    tables = [
        RawTable("run", run["time"].copy(), None, {name: run[name].copy() for name in STATE_FIELDS}) for run in runs
    ]
    return Problem([segment for table in tables for segment in checked(table, BENCH).segments], BENCH)


def sine(amplitude: float) -> ReferenceSignal:
    return ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=0.7)


def law(form: str, coefficient: float) -> Claim:
    return Claim(closure(grammar.ALL["motion", form], BENCH), {"coefficient": coefficient})


def told_apart(reference: ReferenceSignal, found: Fit, rival: Fit) -> float:
    """BIC by which 6 s of a bench with the drag tell the law from the rival."""
    problem = problem_of(driven(reference, 11))
    return score(problem, fit(problem, rival.claims)) - score(problem, fit(problem, found.claims))


def test_the_proposed_recording_tells_the_two_best_laws_apart_better_than_most() -> None:
    narrow = problem_of(driven(sine(260.0), 3))
    found = fit(narrow, [law("quadratic drag", DRAG)])
    proposed = next_for_law(narrow, found)
    assert proposed is not None
    assert proposed["separates"][0] == "quadratic drag (motion)" != proposed["separates"][1]
    assert proposed["separates"][1] in proposed["why"] and "%" in proposed["why"]
    rival = rival_law(narrow, found, 0, fit(narrow, ()))
    assert rival is not None
    best = next(
        one for one in catalog(Bench.nominal())
        if (one.waveform.name.lower(), one.amplitude, one.offset, one.frequency)
        == tuple(proposed["reference"][key] for key in ("waveform", "amplitude", "offset", "frequency"))
    )  # fmt: skip
    others = np.random.default_rng(2).choice(catalog(Bench.nominal()), 3, replace=False)  # type: ignore[arg-type]
    apart = told_apart(best, found, rival)
    assert apart > 10.0
    assert apart > np.median([told_apart(one, found, rival) for one in others])
