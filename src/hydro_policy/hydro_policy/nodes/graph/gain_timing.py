# SPDX-License-Identifier: Apache-2.0
"""Latency from a sample to the gains computed from it."""

from __future__ import annotations

from hydro_bridge.process.latency import Latency
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP

_PERIOD = SAMPLES_PER_STEP * SAMPLE_PERIOD  # s, of a policy step


class GainTiming:
    """Latencies of policy steps, from a sample to the publication of its gains."""

    def __init__(self) -> None:
        self.response = Latency()
        """From the sample's arrival in this process to the gains' publication."""
        self.age = Latency()
        """From the sample's stamp to the gains' stamp: total latency."""
        self.jitter = Latency()
        """|interval between gains - 10 ms|; pauses of five intervals or more are excluded."""
        self._published = 0.0

    def add(self, arrived: float, published: float, age: float) -> None:
        """Count one step: a sample's arrival and the gains' publication [s, monotonic], and their age [s]."""
        self.response.add(published - arrived)
        self.age.add(age)
        interval, self._published = published - self._published, published
        if interval < 5 * _PERIOD:
            self.jitter.add(abs(interval - _PERIOD))
