# SPDX-License-Identifier: Apache-2.0
"""The filter beside the compensated law: its loop, its integral, its certificate, against box and plant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import SAMPLE_PERIOD, Command, CorrectionStatus, FloatArray, Law, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import LoopFilter, default_filter, loop_filter
from hydro_filter.metric import ScheduledMetric, closed_loop_at_rest, solve_lyapunov, spectral_radius
from hydro_filter.model.loop import make_loop, make_samples
from hydro_filter.model.records import linearize
from hydro_filter.model.sample import Sample
from hydro_sim.box.box import Box, BoxConfig, law_state
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

LAW = BoxConfig().compensated
C_1 = LAW.velocity_compensation
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)


@pytest.fixture(scope="module")
def made(bench: Bench, model: Bench, metric: ScheduledMetric) -> LoopFilter:
    return loop_filter(metric, model, bench)


def run(
    bench: Bench, plant: AnalyticPlant, made: LoopFilter | None, seconds: float, gains: tuple[float, float],
    c_1: float = C_1,
) -> Iterator[tuple[Sample, CorrectionStatus, float]]:  # fmt: skip
    """Box, plant and filter under the compensated law; K_p drawn from `gains` a hundred times a second.

    Gives each sample, what the filter makes of it (None: PASS), and the box's integral [N/s] after it.
    """
    law = replace(LAW, velocity_compensation=c_1, velocity_compensation_max=1.0)
    box, x, delta_u = Box(bench, replace(BoxConfig(), compensated=law)), plant.reset(3), 0.0
    rng, status = np.random.default_rng(3), CorrectionStatus.PASS
    command = Command(law=Law.COMPENSATED)
    box.receive(command, 0.0)
    command = replace(
        command, arm=True, reference=SINE, coefficients=(1.02, 0.03, 2e-4, -3.0, 1e-6), velocity_compensation=c_1
    )
    if made is not None:
        made.reset()
    for k in range(round(seconds / SAMPLE_PERIOD)):
        if k % 10 == 0:
            command = replace(command, delta_kp=rng.uniform(*gains) - LAW.base_kp)
        box.receive(replace(command, delta_u=delta_u), k * SAMPLE_PERIOD)
        sample = Sample.from_record(box.tick(x, k * SAMPLE_PERIOD), law_state(box.state[0]))
        if made is not None:
            delta_u, _, _, status = made.correct(sample)
        yield sample, status, float(box.state["integral"][0])
        x = plant.step(sample.valve_current)


def test_the_integral_is_that_of_the_box(bench: Bench) -> None:
    loop, before = make_loop(bench, bench).record, 0.0
    for sample, _, integral in run(bench, AnalyticPlant(bench), None, 0.6, (15.0, 400.0)):
        seen = make_samples(sample.state[None], nominal=sample.nominal_current, k_p=sample.proportional_gain)
        for name, value in zip(("followed", "followed_rate", "c_1", "c_2"), sample.law_inputs, strict=True):
            seen[name] = value
        assert linearize(loop, seen).integral[0] == pytest.approx(before, rel=1e-6, abs=1e-5)
        before = integral
    assert abs(before) > 10.0


@pytest.mark.parametrize("gain", [100.0, 300.0])
def test_twins_under_the_law_come_together_as_the_loops_slowest_eigenvalue_says(model: Bench, gain: float) -> None:
    """Plant and box know nothing of the linearized loop; K_i at its least, it moves the eigenvalue by K_i / K_p."""
    bench = Bench.nominal()
    smooth = replace(model, effects=tuple(each for each in model.effects if each["id"] != "friction_coulomb"))
    slowest = -np.log(spectral_radius(closed_loop_at_rest(make_loop(smooth, bench), gain, C_1))) / SAMPLE_PERIOD

    def pulsed(pulse: float) -> FloatArray:
        """f_l at rest, with a pulse of current [A] at 1 s; in f_h the oil still rings."""
        correction, gains = np.zeros(1400), (gain, LAW.base_ki + LAW.delta_ki_min)
        correction[1000:1005] = pulse
        plan = Schedule(
            reference=ReferenceSignal(), gains=gains, seconds=1.4, correction=correction, law=Law.COMPENSATED
        )
        return np.asarray(simulate(AnalyticPlant(smooth, noise=0.0), bench, plan)["load_force"])

    apart = np.abs(pulsed(1e-4) - pulsed(0.0))
    begin, span = 1100, min(200, round(1.5e3 / slowest))
    decay = np.log(apart[begin] / apart[begin + span]) / (span * SAMPLE_PERIOD)
    assert decay == pytest.approx(slowest, rel=0.15, abs=0.3)


def test_the_certificate_holds_at_every_gain_of_each_law(bench: Bench, model: Bench, metric: ScheduledMetric) -> None:
    """Lyapunov's inequality at rest, between the table's gains, too; at C_1 = 1 there is none above 100 1/s."""
    loop, kept = make_loop(model, bench), np.exp(-2.0 * 0.1 * SAMPLE_PERIOD)
    for one, c_1 in zip(metric.all_metrics, (1.0, C_1), strict=True):
        for gain in np.linspace(one.gains[0], one.gains[-1], 50):
            closed, weight = closed_loop_at_rest(loop, gain, c_1), one.matrix(gain)
            assert np.linalg.eigvalsh(closed.T @ weight @ closed - kept * weight).max() < 0.0
    assert (one.gains[0], one.gains[-1]) == (15.0, 400.0)
    with pytest.raises(ValueError, match="does not decay"):
        solve_lyapunov(closed_loop_at_rest(loop, 200.0), 0.3)


def test_a_file_keeps_both_and_the_shipped_one_holds_for_the_papers_law(
    tmp_path: Path, bench: Bench, model: Bench, metric: ScheduledMetric
) -> None:
    metric = replace(metric, training={"command": "learn_metric"})
    metric.save(tmp_path / "both.safetensors")
    both = ScheduledMetric.load(tmp_path / "both.safetensors")
    assert [one.velocity_compensation for one in both.all_metrics] == [1.0, C_1]
    for ours, theirs in zip(both.all_metrics, metric.all_metrics, strict=True):
        np.testing.assert_array_equal(ours.table, theirs.table)
        np.testing.assert_array_equal(ours.gains, theirs.gains)
        assert (ours.thresholds, ours.training) == (theirs.thresholds, theirs.training)
    shipped = loop_filter(ScheduledMetric.load(), model, bench)
    assert shipped.missing_certificate(compensated=True) and not shipped.missing_certificate(compensated=False)
    alone = loop_filter(both.all_metrics[1], model, bench)
    assert alone.missing_certificate(compensated=False) and not alone.missing_certificate(compensated=True)


def test_a_filter_of_the_papers_law_bypasses_the_compensated_one_and_begins_anew(bench: Bench) -> None:
    law, made = LawState(Law.COMPENSATED, 10.0, 0.0, (1.0, 0.0, 0.0, 0.0, 0.0), C_1, 1.0), default_filter(bench)
    sample = Sample(np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9e6, 0.04, 0.0]), 0.0, 300.0, -40.0)
    result = made.correct(sample._replace(law=law))
    assert (result.delta_u, result.status) == (0.0, CorrectionStatus.BYPASSED)
    assert made.correct(sample).status is CorrectionStatus.MODIFIED


def test_under_the_law_gains_pass_and_a_c_1_without_certificate_is_corrected(model: Bench, made: LoopFilter) -> None:
    done = list(run(Bench.nominal(), AnalyticPlant(model), made, 2.0, (15.0, 400.0)))
    assert {status for _, status, _ in done[200:]} == {CorrectionStatus.PASS}
    sample = done[-1][0]
    foreign = sample._replace(law=sample.law._replace(velocity_compensation=1.0), proportional_gain=300.0)
    assert made.correct(foreign).status is CorrectionStatus.MODIFIED


@pytest.mark.parametrize("filtered", [False, True])
def test_gains_that_would_trip_at_another_c_1_do_not_behind_the_filter(
    bench: Bench, model: Bench, made: LoopFilter, filtered: bool
) -> None:
    *_, (sample, _, _) = run(bench, AnalyticPlant(model), made if filtered else None, 1.5, (150.0, 300.0), c_1=1.0)
    assert sample.armed is filtered


def test_a_stiffer_spring_is_told_under_the_law(bench: Bench, model: Bench, made: LoopFilter) -> None:
    plant = AnalyticPlant(replace(model, spring_stiffness=3e4))
    *_, (_, status, _) = run(bench, plant, made, 2.0, (300.0, 400.0))
    assert status is CorrectionStatus.MISMATCH
