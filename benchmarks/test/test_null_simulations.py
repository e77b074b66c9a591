# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from benchmarks.null_simulations import trial
from hydro_sim.model.bench import Bench


@pytest.mark.study
def test_mass_that_a_coarse_encoder_hides_is_not_claimed() -> None:
    noise, evidence, claim = trial(Bench.nominal(), 28)
    assert noise == pytest.approx(2.32, abs=0.01)  # 0.4 and 0.9 Hz, 2.3 um: by least squares 0.19 kg are missing
    assert claim != "moving_mass"
    assert evidence is None or evidence < 20.0
