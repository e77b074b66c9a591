# SPDX-License-Identifier: Apache-2.0
"""One sample in, one correction out, whatever the sample holds; and the closed loop that follows."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite, isnan, nan

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hydro_bridge.signals import CorrectionStatus, FloatArray, ReferenceSignal, Waveform
from hydro_filter.certificate.continuous import Certificate, HalfLine
from hydro_filter.controller.filter import ContractionFilter, FilterSettings
from hydro_filter.model.sample import Sample
from hydro_filter.validation.trial import Run, Trial, gammas, run
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

U_MAX = 0.05
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
FILTER = ContractionFilter.for_bench(Bench.nominal())


def at(state: FloatArray, error: float, gain: float, current: float = 0.0) -> Sample:
    return Sample(state, current, float(state[2] + error), gain)


@pytest.fixture
def still(bench: Bench) -> FloatArray:
    return AnalyticPlant(bench, noise=0.0).reset(0)


def test_statuses(still: FloatArray) -> None:
    assert FILTER.correct(at(still, 100.0, 90.0)).status is CorrectionStatus.PASS
    assert FILTER.correct(at(still, 100.0, -40.0)).status is CorrectionStatus.MODIFIED
    # a microampere left to the limit, and far more wanted
    relaxed = FILTER.correct(at(still, 500.0, -40.0, U_MAX - 1e-4))
    assert relaxed.status is CorrectionStatus.RELAXED
    assert relaxed.delta_u == pytest.approx(1e-4)
    assert 0.0 < relaxed.after < relaxed.before
    infeasible = FILTER.correct(at(still, 500.0, -40.0, U_MAX))
    assert infeasible == (0.0, infeasible.before, infeasible.before, CorrectionStatus.INFEASIBLE)


def test_stale_state_is_not_acted_upon(still: FloatArray) -> None:
    for age in (0.0051, 1.0, inf, nan):
        result = FILTER.correct(at(still, 100.0, -40.0), age=age)
        assert (result.delta_u, result.status) == (0.0, CorrectionStatus.STALE)
        assert isnan(result.before)
        assert isnan(result.after)
    assert FILTER.correct(at(still, 100.0, -40.0), age=0.0049).status is CorrectionStatus.MODIFIED


def test_bypass_says_so_and_corrects_nothing(bench: Bench, still: FloatArray) -> None:
    bypassed = ContractionFilter.for_bench(bench, FilterSettings(bypass=True)).correct(at(still, 100.0, -40.0))
    assert (bypassed.delta_u, bypassed.status) == (0.0, CorrectionStatus.BYPASSED)
    assert bypassed.before == bypassed.after == FILTER.correct(at(still, 100.0, -40.0)).before > 0.0


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_state_that_is_not_finite_gives_no_correction(still: FloatArray, index: int, value: float) -> None:
    broken = still.copy()
    broken[index] = value
    result = FILTER.correct(Sample(broken, 0.0, 100.0, -40.0))
    assert (result.delta_u, result.status) == (0.0, CorrectionStatus.NAN)
    assert FILTER.correct(at(still, 100.0, -40.0)).status is CorrectionStatus.MODIFIED  # and harms nothing after it


def test_a_law_that_is_not_finite_gives_no_correction(still: FloatArray) -> None:
    for field in ("nominal_current", "reference_force", "proportional_gain"):
        result = FILTER.correct(at(still, 100.0, -40.0)._replace(**{field: nan}))
        assert (result.delta_u, result.status) == (0.0, CorrectionStatus.NAN)


@given(
    values=st.lists(st.floats(width=64), min_size=8, max_size=8),
    current=st.floats(width=64),
    reference=st.floats(width=64),
    gain=st.floats(width=64),
)
@example(values=[0.0] * 6 + [-1.0, 0.0], current=0.0, reference=0.0, gain=0.0)  # chamber A has no volume
@settings(max_examples=500, deadline=None)
def test_correct_never_raises_and_never_leaves_the_valve(
    values: list[float], current: float, reference: float, gain: float
) -> None:
    result = FILTER.correct(Sample(np.array(values), current, reference, gain))
    assert isfinite(result.delta_u)
    if result.delta_u != 0.0:
        assert abs(current + result.delta_u) <= U_MAX + 1e-9 * abs(current)


@pytest.mark.parametrize("current", [-0.3, -0.05, 0.0, 0.02, 0.05, 0.08, 0.3])
@pytest.mark.parametrize("error", [-300.0, 300.0])
def test_the_valve_gets_the_correction_that_was_decided(still: FloatArray, current: float, error: float) -> None:
    """sat(u_nom + delta_u) restores the certificate or stands at the limit; a law beyond it is cut, not corrected."""
    result = FILTER.correct(at(still, error, -40.0, current))
    applied, wanted = np.clip(current, -U_MAX, U_MAX), np.clip(current + result.delta_u, -U_MAX, U_MAX)
    line = FILTER.certificate.evaluate(at(still, error, -40.0, current))
    assert result.after == pytest.approx(line.value(wanted - applied), abs=1e-9)
    assert result.status is CorrectionStatus.MODIFIED or abs(wanted) == U_MAX
    assert FILTER.correct(at(still, error, 90.0, current)).delta_u == 0.0


class Reversed(Certificate):
    """v with the sign that the paper prints."""

    def evaluate(self, sample: Sample, v: FloatArray | None = None) -> HalfLine:
        return super().evaluate(sample, -self.displacement(sample))


def closed_loop(bench: Bench, contraction_filter: ContractionFilter, gains: FloatArray, seed: int = 0) -> Run:
    return run(Trial(bench=bench, reference=SINE, gains=gains, seed=seed), AnalyticPlant(bench), contraction_filter)


def test_the_printed_sign_of_v_drives_the_force_away(bench: Bench) -> None:
    """Erratum of safety.md: constant destabilizing gains, three ways."""
    gains = np.full((200, 2), (-5.0, 0.0))
    certificate = Reversed(**{name: getattr(FILTER.certificate, name) for name in Certificate.__dataclass_fields__})
    kept = closed_loop(bench, FILTER, gains)
    bare = closed_loop(bench, ContractionFilter(FILTER.certificate, FilterSettings(bypass=True)), gains)
    printed = closed_loop(bench, ContractionFilter(certificate), gains)
    assert kept.bounded
    assert not bare.bounded
    assert not printed.bounded
    assert len(printed.states) < len(bare.states)


def test_stable_gains_are_left_alone(bench: Bench) -> None:
    result = closed_loop(bench, ContractionFilter.for_bench(bench), np.full((300, 2), (90.0, 15.0)))
    assert result.bounded
    numbers = gammas(result.results, U_MAX)
    assert numbers.correction == 0.0
    assert numbers.violated_before == numbers.violated_after == 0.0
    assert numbers.mean_before < 0.0


def random_gains(seed: int, hold: int) -> FloatArray:
    """18 s of the paper's 'Validate Unstable': K_p in [-40, 40], K_i in [-5, 5], held for `hold` steps of 10 ms."""
    rng, draws = np.random.default_rng(seed), 1800 // hold
    return np.repeat(np.column_stack([rng.uniform(-40, 40, draws), rng.uniform(-5, 5, draws)]), hold, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("cell", [None, 25.0], ids=["ideal cell", "lagging cell"])
@pytest.mark.parametrize(("hold", "rate"), [(1, 0.1), (50, 1.0)], ids=["every 10 ms", "every 0.5 s"])
@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.study)])
def test_random_gains_stay_bounded_under_the_filter(
    bench: Bench, cell: float | None, hold: int, rate: float, seeds: int
) -> None:
    """Table of filter_figures.md, fewer seeds. Without the filter most runs trip; with it none does."""
    plant = replace(bench, load_cell_bandwidth=cell)
    kept, lost = 0, 0
    for seed in range(seeds):
        trial = Trial(bench=bench, reference=SINE, gains=random_gains(seed, hold), seed=seed)
        active = ContractionFilter.for_bench(bench, FilterSettings(contraction_rate=rate))
        bare = ContractionFilter.for_bench(bench, FilterSettings(bypass=True))
        kept += run(trial, AnalyticPlant(plant), active).bounded
        lost += not run(trial, AnalyticPlant(plant), bare).bounded
    assert kept == seeds
    assert lost >= 7 * seeds // 10
