# SPDX-License-Identifier: Apache-2.0
"""The default schedule of offline recordings, and fitting a schedule to a duration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.excitation.schedules import Segment

DEFAULT_SCHEDULE = (
    Segment(seconds=6.0, waveform="multisine", amplitude=280.0, frequency=0.7),
    Segment(seconds=4.0, waveform="sine", amplitude=250.0, frequency=1.5),
    Segment(seconds=4.0, waveform="smooth_step", amplitude=200.0, frequency=0.5),
    Segment(seconds=4.0, waveform="sine", amplitude=150.0, offset=100.0, frequency=0.5),
    Segment(seconds=2.0, waveform="hold", offset=-100.0),
)
"""Default schedule of 20 s, of varied waveforms."""


def fit_to(segments: Sequence[Segment], seconds: float) -> list[Segment]:
    """Repeat or cut the segments so that they last `seconds` in total."""
    result: list[Segment] = []
    left = seconds
    while left > 0.5 * SAMPLE_PERIOD:
        segment = segments[len(result) % len(segments)]
        result.append(replace(segment, seconds=min(segment.seconds, left)))
        left -= segment.seconds
    return result
