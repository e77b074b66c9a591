# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import Fit, fit, score
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import catalog, expected_gain, simulated_recording
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
EFFECTS = {effect.label: effect.adapted(BENCH) for effect in LIBRARY}
TRUTH = replace(BENCH, supply_pressure=0.985 * BENCH.supply_pressure)
STILL = ReferenceSignal(waveform=Waveform.SINE, amplitude=10.0, offset=0.0, frequency=0.3)


def fits(problem: Problem) -> tuple[Fit, Fit]:
    """The true cause and a rival to it."""
    true = fit(problem, [Claim(EFFECTS["supply_pressure"], {"ratio": 0.99})])
    return true, fit(problem, [Claim(EFFECTS["valve_gain"], {"ratio": 0.99})])


def told_apart(reference: ReferenceSignal, seed: int) -> float:
    """BIC by which a recording of a bench with a low supply pressure tells it from a low valve gain."""
    recording = simulated_recording(BENCH, reference, truth=TRUTH, seconds=6.0, seed=seed)
    problem = Problem(recording.segments, BENCH)
    true, rival = fits(problem)
    return score(problem, rival) - score(problem, true)


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
