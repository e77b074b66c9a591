# SPDX-License-Identifier: Apache-2.0
"""A valve's overlap in the filter: counted in the certificate, leapt over, absent where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import CorrectionStatus, ReferenceSignal, Waveform
from hydro_filter.controller import loop_decision
from hydro_filter.controller.loop_filter import LoopFilter, loop_parts
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import memories, overlap_of, without_overlap
from hydro_filter.model.overlap import Overlap, change_for, passed_change
from hydro_filter.model.sample import Sample
from hydro_filter.precompile import FOUND
from hydro_filter.validation.runs import Run, Trial, run
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

WIDTH = 5e-4
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


@pytest.fixture(scope="module")
def overlapped(bench: Bench) -> Bench:
    return replace(bench, effects=(*FOUND, {"id": "valve_deadband", "parameters": {"half_width": WIDTH}}))


@pytest.fixture(scope="module")
def made(bench: Bench, overlapped: Bench) -> LoopFilter:
    return LoopFilter(loop_parts(ScheduledMetric.load(), overlapped, bench))


def closed(made: LoopFilter, bench: Bench, plant: AnalyticPlant, gains: tuple[float, float]) -> Run:
    return run(Trial(bench=bench, reference=SINE, gains=np.tile(gains, (300, 1)), seed=4), plant, made)


def error_of(done: Run) -> float:
    """RMSE [N] after the first second."""
    return float(np.sqrt(np.mean((done.states["reference_force"] - done.states["load_force"])[1000:] ** 2)))


def test_the_change_is_the_smallest_after_which_that_much_more_passes() -> None:
    rng = np.random.default_rng(0)
    for _ in range(2000):
        overlap = Overlap(rng.uniform(-1.0, 1.0), *rng.uniform(0.0, 1.0, 2))
        current, passing = rng.uniform(-3.0, 3.0), rng.uniform(-2.0, 2.0)
        change = change_for(overlap, current, passing)
        assert passed_change(overlap, current, change) == pytest.approx(passing, abs=1e-12)
        assert abs(passed_change(overlap, current, 0.999 * change)) < abs(passing), "nothing smaller does"
        assert change * passing > 0.0


def test_the_overlap_is_the_bench_files(bench: Bench, overlapped: Bench) -> None:
    shift = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    lopsided = {
        "id": "valve_deadband", "form": "lopsided", "parameters": {"half_width": 4e-4, "half_width_negative": 2e-4},
    }  # fmt: skip
    assert overlap_of(bench) == Overlap() and without_overlap(bench) is None
    assert overlap_of(overlapped) == Overlap(0.0, WIDTH, WIDTH)
    assert overlap_of(Bench.from_mapping(bench.to_mapping() | {"effects": [shift, lopsided]})) == Overlap(
        -1e-3, 2e-4, 4e-4
    )
    assert without_overlap(overlapped) == replace(bench, effects=FOUND)


@pytest.mark.study
def test_the_correction_is_the_smallest_that_restores_the_certificate_across_the_overlap(
    bench: Bench, overlapped: Bench, made: LoopFilter
) -> None:
    """Against a search over all currents."""
    done = closed(made, bench, AnalyticPlant(overlapped), (250.0, 15.0))
    parts, memory = made.parts, memories()
    space, leaps = loop_decision.workspace(parts), 0
    changes = np.linspace(-4e-3, 4e-3, 16001)
    for k, record in enumerate(done.states):
        one = Sample.of(record)
        signals = one.nominal_current, one.valve_current, one.reference_force, one.reference_rate
        problem = loop_decision.build_problem(
            parts, memory[0], one.state, *signals, one.proportional_gain, one.followed, space
        )
        if k % 20 or done.results[k].status is not CorrectionStatus.MODIFIED:
            continue
        after = [loop_decision.certificate_before_after(parts.overlap, problem, each)[1] for each in changes]
        smallest = np.abs(changes[np.array(after) <= 0.0]).min()
        assert abs(done.results[k].delta_u) == pytest.approx(smallest, abs=1e-6)
        assert done.results[k].after <= 1e-6
        leaps += abs(done.results[k].delta_u) > WIDTH
    assert leaps > 10


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_a_filter_that_counts_with_the_overlap_follows_closer_than_one_that_takes_it_for_a_disturbance(
    bench: Bench, made: LoopFilter, share: float
) -> None:
    """Also where the bench's overlap is a fifth narrower or wider than the file's."""
    overlap = {"id": "valve_deadband", "parameters": {"half_width": share * WIDTH}}
    plant = AnalyticPlant(replace(bench, effects=(*FOUND, overlap)))
    blind = LoopFilter(made.parts._replace(overlap=Overlap()))
    runs = [closed(each, bench, plant, (250.0, 15.0)) for each in (made, blind)]
    assert all(each.bounded for each in runs)
    assert error_of(runs[0]) < 0.5 * error_of(runs[1])
