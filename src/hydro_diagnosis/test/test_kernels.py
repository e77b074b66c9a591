# SPDX-License-Identifier: Apache-2.0
"""The compiled inner loops say the same as the equations in numpy that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.preprocessing.smoothing import finish, finish_at, kinematics, smooth, smooth_at


@pytest.mark.parametrize("spacing", [1, 5])
def test_smoothing_at_some_samples_is_that_of_all(spacing: int) -> None:
    signal, rows = np.random.default_rng(1).standard_normal(400), np.array([0, 3, 50, 399])
    np.testing.assert_allclose(smooth_at(signal, rows, spacing), smooth(signal, spacing)[rows], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(finish_at(signal, rows, spacing), finish(signal, spacing)[rows], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 4])
def test_means_over_substeps_are_those_of_numpy_to_the_bit(count: int) -> None:
    signal = 1e-2 * np.random.default_rng(3).standard_normal((1000, count))
    np.testing.assert_array_equal(kernels.substep_mean(signal), signal.mean(axis=-1))
    for sign in (1.0, -1.0):
        np.testing.assert_array_equal(
            kernels.substep_mean_beyond(signal, sign), np.maximum(sign * signal, 0.0).mean(axis=-1)
        )


def test_kinematics_are_exact_on_parabolas() -> None:
    time = np.arange(200) * 1e-3
    x, v, a = kinematics(0.04 + 0.3 * time - 2.0 * time**2, 1e-3)
    inner = slice(20, -20)
    assert np.allclose(a[inner], -4.0)
    assert np.allclose(v[inner], (0.3 - 4.0 * time)[inner])
    assert np.allclose(finish(a)[inner], -4.0)
    assert np.allclose(x[inner], (0.04 + 0.3 * time - 2.0 * time**2 - 2.0 * 1e-6)[inner], atol=1e-9)
