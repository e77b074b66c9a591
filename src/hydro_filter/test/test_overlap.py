# SPDX-License-Identifier: Apache-2.0
"""A valve's overlap in the filter: counted in the certificate, leapt over, absent where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import CorrectionStatus, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import LoopFilter, loop_parts
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import without_overlap
from hydro_filter.model.terms import valve_overlap
from hydro_filter.precompile import EXAMPLE_EFFECTS
from hydro_filter.validation.runs import Run, Trial, run, tracking_rmse
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

WIDTH = 5e-4
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


@pytest.fixture(scope="module")
def overlapped(bench: Bench) -> Bench:
    return replace(bench, effects=(*EXAMPLE_EFFECTS, {"id": "valve_deadband", "parameters": {"half_width": WIDTH}}))


@pytest.fixture(scope="module")
def made(bench: Bench, overlapped: Bench) -> LoopFilter:
    return LoopFilter(loop_parts(ScheduledMetric.load(), overlapped, bench))


def closed(made: LoopFilter, bench: Bench, plant: AnalyticPlant, gains: tuple[float, float]) -> Run:
    return run(Trial(bench=bench, reference=SINE, gains=np.tile(gains, (300, 1)), seed=4), plant, made)


def test_the_overlap_is_the_bench_files(bench: Bench, overlapped: Bench) -> None:
    shift = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    lopsided = {
        "id": "valve_deadband", "form": "lopsided", "parameters": {"half_width": 4e-4, "half_width_negative": 2e-4},
    }  # fmt: skip
    assert valve_overlap(bench) == {"closing": 0.0, "back": 0.0, "out": 0.0} and without_overlap(bench) is None
    assert valve_overlap(overlapped) == {"closing": 0.0, "back": WIDTH, "out": WIDTH}
    assert valve_overlap(Bench.from_mapping(bench.to_mapping() | {"effects": [shift, lopsided]})) == {
        "closing": -1e-3, "back": 2e-4, "out": 4e-4,
    }  # fmt: skip
    assert without_overlap(overlapped) == replace(bench, effects=EXAMPLE_EFFECTS)


def test_corrections_leap_across_the_overlap(bench: Bench, overlapped: Bench, made: LoopFilter) -> None:
    """That they are the smallest is `firmware/test/test_filter.c`'s."""
    done = closed(made, bench, AnalyticPlant(overlapped), (250.0, 15.0))
    modified = [result for result in done.results if result.status is CorrectionStatus.MODIFIED]
    assert max(result.after for result in modified) <= 1e-6
    assert sum(abs(result.delta_u) > WIDTH for result in modified) > 10


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_a_filter_that_counts_with_the_overlap_follows_closer_than_one_that_takes_it_for_a_disturbance(
    bench: Bench, made: LoopFilter, share: float
) -> None:
    """Also where the bench's overlap is a fifth narrower or wider than the file's."""
    overlap = {"id": "valve_deadband", "parameters": {"half_width": share * WIDTH}}
    plant = AnalyticPlant(replace(bench, effects=(*EXAMPLE_EFFECTS, overlap)))
    blind = LoopFilter(made.parts.copy())
    blind.parts["back"] = blind.parts["out"] = 0.0
    runs = [closed(each, bench, plant, (250.0, 15.0)) for each in (made, blind)]
    assert all(each.bounded for each in runs)
    counted, ignored = (tracking_rmse(each.states[1000:]) for each in runs)
    assert counted < 0.5 * ignored
