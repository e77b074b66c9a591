# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_bridge.clock import BoxClock

OFFSET = 1_700_000_000_000_000_000


def run(clock: BoxClock, delays_us: np.ndarray, drift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Stamps of samples every millisecond, and the true times at which they were taken [ns]."""
    box = 1000 * np.arange(len(delays_us), dtype=np.int64)
    true = OFFSET + (1000 * box * (1.0 + drift)).astype(np.int64)
    stamps = [clock.stamp(int(b), int(t + 1000 * d)) for b, t, d in zip(box, true, delays_us, strict=True)]
    return np.array(stamps), true


def test_error_is_the_quickest_delivery_whatever_the_others_did():
    random = np.random.default_rng(0)
    delays = 200 + random.exponential(800, 5000)
    stamps, true = run(BoxClock(), delays)
    settled = (stamps - true)[1000:] / 1000
    assert delays.min() - 1 <= settled.min() and settled.max() < 210


def test_drift_is_followed():
    random = np.random.default_rng(1)
    stamps, true = run(BoxClock(), 200 + random.exponential(300, 30_000), drift=50e-6)
    assert np.abs(stamps - true)[2000:].max() < 400_000  # 0.2 ms of delivery and at most 2 s of 50 ppm


@settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow])  # a busy machine draws slowly
@given(st.lists(st.integers(0, 50_000), min_size=2, max_size=300))
def test_stamps_ascend_whatever_the_delays(delays):
    stamps, _ = run(BoxClock(), np.array(delays))
    steps = np.diff(stamps)
    assert np.all(steps > 0)
    assert np.all(np.abs(steps - 1_000_000) <= 50_001)  # the box's millisecond, slewed by at most 5 %
