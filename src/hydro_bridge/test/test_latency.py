# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from hydro_bridge.process.latency import Latency


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
