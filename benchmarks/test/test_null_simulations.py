# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from math import exp

import pytest

from benchmarks.null_simulations import false_claims, needed, trial
from hydro_sim.model.bench import Bench

pytestmark = pytest.mark.study


def test_threshold_is_worth_what_the_trials_reach() -> None:
    trials = [(1.0, evidence, "x") for evidence in (1.0, 2.0, 3.0, 4.0, 5.0, 30.0)]
    false, limit, expected = false_claims(trials, 20.0)
    assert false == 1
    assert limit == pytest.approx(0.582, abs=1e-3)  # Clopper and Pearson, 1 of 6
    middle, excess = 3.5, (0.5 + 1.5 + 26.5) / 3
    assert expected == pytest.approx(0.5 * exp(-(20.0 - middle) / excess))
    assert needed(trials, 1e-3) >= 30.0


def test_mass_that_a_coarse_encoder_hides_is_not_claimed() -> None:
    noise, evidence, claim = trial(Bench.nominal(), 28)
    assert noise == pytest.approx(2.32, abs=0.01)  # 0.4 and 0.9 Hz, 2.3 um: by least squares 0.19 kg are missing
    assert claim != "moving_mass"
    assert evidence is None or evidence < 20.0
