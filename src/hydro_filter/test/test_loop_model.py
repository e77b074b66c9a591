# SPDX-License-Identifier: Apache-2.0
"""The loop where its model has a corner; that F, G and K are derivatives: `test_loop_derivatives`."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_filter.model.force_law import PAPER_SCALES
from hydro_filter.model.loop_model import LoopModel, linearize, loop_model, loop_step
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench


@pytest.fixture(scope="module")
def loop(bench: Bench) -> LoopModel:
    return loop_model(Learned.load().model, bench)  # type: ignore[arg-type]


def test_a_spool_that_passes_zero_is_linearized_on_the_side_it_comes_from(loop: LoopModel) -> None:
    x, step = np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9.9e6, 0.04, 0.0]), loop_step()
    linearize(loop, np.array([1e-5, 0.0, 0.0]), x, 1e-5, 1e-5, 90.0, PAPER_SCALES, step)
    still = step.transition.copy()
    linearize(loop, np.array([1e-5, -0.1, 0.0]), x, 1e-5, -3e-3, 90.0, PAPER_SCALES, step)
    np.testing.assert_allclose(step.transition, still, rtol=1e-3, atol=1e-4)
