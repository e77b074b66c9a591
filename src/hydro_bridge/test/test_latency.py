# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time

import numpy as np

from hydro_bridge.process.latency import Latency, Pacer


def test_percentiles_are_exact_to_a_microsecond():
    random = np.random.default_rng(0)
    durations = random.exponential(1e-3, 20_000)
    latency = Latency()
    for duration in durations:
        latency.add(float(duration))
    for percent in (50, 99, 99.9):
        assert abs(latency.percentile(percent) - np.percentile(durations, percent, method="inverted_cdf")) <= 1.1e-6


def test_what_is_longer_than_the_histogram_is_not_made_shorter():
    latency = Latency()
    latency.add(0.5)
    assert latency.percentile(99) == 0.5 and latency.longest == 0.5


def test_time_away_is_left_out_and_a_short_delay_is_caught_up_on() -> None:
    pacer = Pacer(1e-3, give_up=2.0)  # longer than a busy machine keeps a thread waiting
    start = pacer.deadline_ns
    time.sleep(0.02)
    for _ in range(30):
        pacer.wait()
    assert pacer.deadline_ns == start + 30_000_000 and pacer.skipped == 0.0 and pacer.late >= 15
    pacer = Pacer(1e-3, give_up=0.05)
    time.sleep(0.1)
    before = time.monotonic_ns()
    pacer.wait()
    assert pacer.skipped >= 0.09
    assert before - 1_000_000 <= pacer.deadline_ns <= time.monotonic_ns() + 1_000_000
