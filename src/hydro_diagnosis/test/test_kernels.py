# SPDX-License-Identifier: Apache-2.0
"""The compiled inner loops say the same as the equations in numpy that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_diagnosis.preprocessing.smoothing import finish, finish_at, smooth, smooth_at


@pytest.mark.parametrize("spacing", [1, 5])
def test_smoothing_at_some_samples_is_that_of_all(spacing: int) -> None:
    signal, rows = np.random.default_rng(1).standard_normal(400), np.array([0, 3, 50, 399])
    np.testing.assert_allclose(smooth_at(signal, rows, spacing), smooth(signal, spacing)[rows], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(finish_at(signal, rows, spacing), finish(signal, spacing)[rows], rtol=0.0, atol=1e-12)
