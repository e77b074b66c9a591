# SPDX-License-Identifier: Apache-2.0
"""The filter beside the compensated law: its loop, its integral, its certificate, against box and plant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import (
    SAMPLE_PERIOD,
    Command,
    CorrectionStatus,
    FloatArray,
    Law,
    LawCommand,
    ReferenceSignal,
    Waveform,
)
from hydro_filter.controller.loop_filter import LoopFilter, default_filter, loop_filter
from hydro_filter.metric import ScheduledMetric, closed_loop_at_rest, solve_lyapunov, spectral_radius
from hydro_filter.model.loop import make_loop, make_samples
from hydro_filter.model.records import linearize
from hydro_filter.model.sample import Sample
from hydro_filter.precompile import EXAMPLE_EFFECTS
from hydro_sim.box.box import Box, BoxConfig, law_state
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

LAW = BoxConfig().compensated
C_1 = LAW.velocity_compensation
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
SHAPED = LawCommand(
    law=Law.COMPENSATED, coefficients=(1.02, 0.03, 2e-4, -3.0), velocity_compensation=C_1, valve_gain_scale=1.0
)


@pytest.fixture(scope="module")
def made(bench: Bench, model: Bench, metric: ScheduledMetric) -> LoopFilter:
    return loop_filter(metric, model, bench)


def run(
    bench: Bench, plant: AnalyticPlant, one: LoopFilter | None, seconds: float, gains: tuple[float, float],
    c_1: float = C_1,
) -> Iterator[tuple[Sample, CorrectionStatus, Box]]:  # fmt: skip
    """Box, plant and filter under the compensated law; K_p drawn from `gains` a hundred times a second."""
    law = replace(LAW, velocity_compensation=c_1, velocity_compensation_max=1.0)
    shaped = vars(replace(SHAPED, velocity_compensation=c_1))
    box, x, delta_u = Box(bench, replace(BoxConfig(), compensated=law)), plant.reset(3), 0.0
    rng = np.random.default_rng(3)
    box.receive(Command(law=Law.COMPENSATED), 0.0)
    if one is not None:
        one.reset()
    for k in range(round(seconds / SAMPLE_PERIOD)):
        if k % 10 == 0:
            delta_kp = rng.uniform(*gains) - LAW.base_kp
        command = Command(arm=True, reference=SINE, delta_kp=delta_kp, delta_u=delta_u, **shaped)
        box.receive(command, k * SAMPLE_PERIOD)
        sample = Sample.from_record(box.tick(x, k * SAMPLE_PERIOD), law_state(box.state[0]))
        result = None if one is None else one.correct(sample)
        delta_u = 0.0 if result is None else result.delta_u
        yield sample, CorrectionStatus.PASS if result is None else result.status, box
        x = plant.step(sample.valve_current)


def test_the_integral_is_that_of_the_box(bench: Bench) -> None:
    loop, before = make_loop(bench, bench).record, 0.0
    for sample, _, box in run(bench, AnalyticPlant(bench), None, 0.6, (15.0, 400.0)):
        seen = make_samples(sample.state[None], nominal=sample.nominal_current, k_p=sample.proportional_gain)
        for name, value in zip(("followed", "followed_rate", "c_1", "c_2"), sample.law_inputs, strict=True):
            seen[name] = value
        assert linearize(loop, seen).integral[0] == pytest.approx(before, rel=1e-6, abs=1e-5)
        before = float(box.state["integral"][0])
    assert abs(before) > 10.0


def pulsed(bench: Bench, plant: AnalyticPlant, gain: float, pulse: float) -> FloatArray:
    """f_l of a run under the law at rest, with a pulse of current [A] at 1 s, shape (1400,)."""
    gains, correction = (gain, LAW.base_ki + LAW.delta_ki_min), np.zeros(1400)
    correction[1000:1005] = pulse
    schedule = Schedule(
        reference=ReferenceSignal(), gains=gains, seconds=1.4, correction=correction, law=Law.COMPENSATED
    )
    return np.asarray(simulate(plant, bench, schedule)["load_force"])


@pytest.mark.parametrize("gain", [100.0, 300.0])
def test_twins_under_the_law_come_together_as_the_loops_slowest_eigenvalue_says(bench: Bench, gain: float) -> None:
    """Plant and box know nothing of the linearized loop; K_i at its least, it moves the eigenvalue by K_i / K_p."""
    smooth = replace(bench, effects=tuple(each for each in EXAMPLE_EFFECTS if each["id"] != "friction_coulomb"))
    slowest = -np.log(spectral_radius(closed_loop_at_rest(make_loop(smooth, bench), gain, C_1))) / SAMPLE_PERIOD
    plant = AnalyticPlant(smooth, noise=0.0)
    apart = np.abs(pulsed(bench, plant, gain, 1e-4) - pulsed(bench, plant, gain, 0.0))  # in f_h the oil still rings
    begin, span = 1100, min(200, round(1.5e3 / slowest))
    decay = np.log(apart[begin] / apart[begin + span]) / (span * SAMPLE_PERIOD)
    assert decay == pytest.approx(slowest, rel=0.15, abs=0.3)


def test_the_certificate_holds_at_every_gain_of_the_law(bench: Bench, model: Bench, metric: ScheduledMetric) -> None:
    """Lyapunov's inequality at rest, between the table's gains, too; at C_1 = 1 there is none above 100 1/s."""
    loop, one = make_loop(model, bench), metric.certificates[1]
    for gain in np.linspace(15.0, 400.0, 50):
        closed, weight = closed_loop_at_rest(loop, gain, C_1), one.matrix(gain)
        kept = np.exp(-2.0 * 0.1 * SAMPLE_PERIOD)
        assert np.linalg.eigvalsh(closed.T @ weight @ closed - kept * weight).max() < 0.0
    with pytest.raises(ValueError, match="does not decay"):
        solve_lyapunov(closed_loop_at_rest(loop, 200.0), 0.3)


def test_a_file_keeps_both_and_the_shipped_one_holds_for_the_papers_law(
    tmp_path: Path, bench: Bench, model: Bench, metric: ScheduledMetric
) -> None:
    metric = replace(metric, training={"command": "learn_metric"})
    metric.save(tmp_path / "both.safetensors")
    both = ScheduledMetric.load(tmp_path / "both.safetensors")
    assert [one.velocity_compensation for one in both.certificates] == [1.0, C_1]
    for ours, theirs in zip(both.certificates, metric.certificates, strict=True):
        np.testing.assert_array_equal(ours.table, theirs.table)
        np.testing.assert_array_equal(ours.gains, theirs.gains)
        assert (ours.thresholds, ours.training) == (theirs.thresholds, theirs.training)
    shipped = loop_filter(ScheduledMetric.load(), model, bench)
    assert shipped.missing_certificate(compensated=True) and not shipped.missing_certificate(compensated=False)
    alone = loop_filter(both.certificates[1], model, bench)
    assert alone.missing_certificate(compensated=False) and not alone.missing_certificate(compensated=True)


def test_a_filter_of_the_papers_law_bypasses_the_compensated_one_and_begins_anew(bench: Bench) -> None:
    law, made = LawState(Law.COMPENSATED, 10.0, 0.0, (1.0, 0.0, 0.0, 0.0), C_1, 1.0), default_filter(bench)
    sample = Sample(np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9e6, 0.04, 0.0]), 0.0, 300.0, -40.0)
    result = made.correct(sample._replace(law=law))
    assert (result.delta_u, result.status) == (0.0, CorrectionStatus.BYPASSED)
    assert made.correct(sample).status is CorrectionStatus.MODIFIED


def test_under_the_law_gains_pass_and_a_c_1_without_certificate_is_corrected(bench: Bench, made: LoopFilter) -> None:
    plant = AnalyticPlant(replace(bench, effects=EXAMPLE_EFFECTS))
    done = [(sample, status) for sample, status, _ in run(bench, plant, made, 2.0, (15.0, 400.0))]
    statuses = {status for sample, status in done[200:]}
    assert statuses == {CorrectionStatus.PASS}
    sample = done[-1][0]
    foreign = sample._replace(law=sample.law._replace(velocity_compensation=1.0), proportional_gain=300.0)
    assert made.correct(foreign).status is CorrectionStatus.MODIFIED


def test_gains_that_would_trip_at_another_c_1_do_not_behind_the_filter(
    bench: Bench, model: Bench, made: LoopFilter
) -> None:
    for one, held in ((None, False), (made, True)):
        *_, (sample, _, _) = run(bench, AnalyticPlant(model), one, 1.5, (150.0, 300.0), c_1=1.0)
        assert sample.armed is held


def test_a_stiffer_spring_is_told_under_the_law(bench: Bench, made: LoopFilter) -> None:
    plant = AnalyticPlant(replace(bench, spring_stiffness=3e4, effects=EXAMPLE_EFFECTS))
    statuses = [status for _, status, _ in run(bench, plant, made, 2.0, (300.0, 400.0))]
    assert statuses[-1] is CorrectionStatus.MISMATCH
