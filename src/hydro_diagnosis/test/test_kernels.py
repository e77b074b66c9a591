# SPDX-License-Identifier: Apache-2.0
"""The compiled inner loops say the same as the equations in numpy that they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.effects.kernels import held_lag, opened
from hydro_diagnosis.model.chambers import fading_sums
from hydro_diagnosis.preprocessing.smoothing import finish, finish_at, smooth, smooth_at


@pytest.mark.parametrize("spacing", [1, 5])
def test_smoothing_at_some_samples_is_that_of_all(spacing: int) -> None:
    signal, rows = np.random.default_rng(1).standard_normal(400), np.array([0, 3, 50, 399])
    np.testing.assert_allclose(smooth_at(signal, rows, spacing), smooth(signal, spacing)[rows], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(finish_at(signal, rows, spacing), finish(signal, spacing)[rows], rtol=0.0, atol=1e-12)


def test_sums_that_fade_are_those_whose_slow_part_is_taken_off() -> None:
    """As an observer takes it off: the slow part follows the sum by 0.008 of the difference per sample."""
    built = np.random.default_rng(2).standard_normal((2, 300))
    slow, left = np.zeros(2), []
    for total in np.cumsum(built, axis=1).T - built.T:
        left.append(total - slow)
        slow = slow + 0.008 * (total - slow)
    np.testing.assert_allclose(fading_sums(built, 0.992), np.stack(left, axis=1), rtol=0.0, atol=1e-11)


def test_a_held_lag_runs_as_its_differential_equation() -> None:
    """w' = (s - w) / time, integrated in a thousand parts of each step."""
    signal, step, time, now = np.array([0.4, -1.0, 2.0, 2.0]), 0.01, 0.02, 0.7
    begins, means = [], []
    for value in signal:
        parts = [now]
        for _ in range(1000):
            parts.append(parts[-1] + (value - parts[-1]) * step / 1000 / time)
        begins.append(now)
        means.append(np.mean(parts))
        now = parts[-1]
    np.testing.assert_allclose(held_lag(signal, step, time, 0.7), [begins, means], rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("count", [1, 4])
def test_means_over_substeps_are_those_of_numpy_to_the_bit(count: int) -> None:
    signal = 1e-2 * np.random.default_rng(3).standard_normal((1000, count))
    np.testing.assert_array_equal(kernels.substep_mean(signal), signal.mean(axis=-1))
    for sign in (1.0, -1.0):
        np.testing.assert_array_equal(
            kernels.substep_mean_beyond(signal, sign), np.maximum(sign * signal, 0.0).mean(axis=-1)
        )


@pytest.mark.parametrize(("width", "soft"), [(1e-3, 1e-4), (0.0, 1e-4), (5e-4, 5e-6), (2e-2, 5e-3)])
def test_soft_edges_pass_a_softplus_on_either_side(width: float, soft: float) -> None:
    """Beyond the overlap they pass what exceeds it; within it hardly anything; and both sides alike."""
    current = np.repeat(1e-2 * np.random.default_rng(4).standard_normal((500, 1)), 4, axis=1)
    beyond, below = (np.logaddexp(0.0, (sign * current - width) / soft) for sign in (1.0, -1.0))
    np.testing.assert_allclose(opened(current, width, soft), soft * (beyond - below), rtol=1e-12, atol=1e-18)
    np.testing.assert_array_equal(opened(-current, width, soft), -opened(current, width, soft))
