# SPDX-License-Identifier: Apache-2.0
"""Thinned series show what was there, and stay as large as they are."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.dashboard.thinning import SLOT, Thinner

START = 1_000_000 * SLOT


def samples(count: int, start: float = START) -> tuple[np.ndarray, np.ndarray]:
    times = start + 1e-3 * (np.arange(count) + 0.5)
    return times, np.random.default_rng(count).standard_normal((count, 2))


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=20))
def test_least_and_greatest_of_each_slot_however_samples_come_in(parts: list[int]) -> None:
    count = sum(parts)
    times, values = samples(count)
    thinner, begin, taken = Thinner(2), 0, []
    for part in parts:
        thinner.add(times[begin : begin + part], values[begin : begin + part])
        begin += part
        taken.append(thinner.take().values)
    got = np.concatenate(taken)
    closed = (count - 1) // 10
    blocks = values[: 10 * closed].reshape(closed, 10, 2)
    np.testing.assert_allclose(got[..., 0], blocks.min(axis=1), rtol=1e-6)
    np.testing.assert_allclose(got[..., 1], blocks.max(axis=1), rtol=1e-6)


def test_a_clock_that_was_set_begins_the_series_anew_and_old_samples_are_left_out() -> None:
    thinner = Thinner(2)
    times, values = samples(100)
    thinner.add(times, values)
    thinner.add(times[:20], 100.0 + values[:20])
    assert thinner.take().values.max() < 50.0
    thinner.add(times - 3600.0, values)
    assert thinner.take().first == round(START / SLOT) - 360_000
