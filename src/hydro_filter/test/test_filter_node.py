# SPDX-License-Identifier: Apache-2.0
"""The running node: one Correction for each BenchState, with the numbers of the core."""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest
import yaml

pytest.importorskip("hydro_msgs.msg", reason="source install/setup.bash")

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.messages import STATES, pack_law_state
from hydro_bridge.ros.topics import (
    BOX,
    CORRECTION,
    DIAGNOSTICS,
    LAW_STATE,
    STATE,
    create_publisher,
    create_subscription,
)
from hydro_bridge.serial.protocol import LawState
from hydro_core.signals import (
    OUTSIDE_REGION,
    PLANT_FIELDS,
    STATE_FIELDS,
    STATUS_MASK,
    CorrectionStatus,
    Flag,
    Law,
    ReferenceSignal,
    Waveform,
)
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_filter
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.sample import Sample
from hydro_msgs.msg import BoxInfo, Correction
from hydro_msgs.msg import LawState as LawStateMessage
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.offline import record_offline
from hydro_sim.excitation import Segment
from hydro_sim.files import learned_bench
from hydro_sim.files.learned_bench import digest as digest_of
from hydro_sim.files.pairing import MadeFor
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.changing_plant import modified_truth
from tests.checks import wait
from tests.domains import reserved_domain

pytestmark = pytest.mark.graph


class Source:
    """Publishes states as a plant does and keeps the corrections that come back."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("source", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.corrections: list[Correction] = []
        self.diagnostics: list[DiagnosticStatus] = []
        self.states = create_publisher(self.node, STATE)
        self._answers = create_subscription(self.node, CORRECTION, self.corrections.append)
        create_subscription(self.node, DIAGNOSTICS, lambda array: self.diagnostics.extend(array.status))

    def wait(self, condition: Callable[[], bool], timeout: float = 150.0) -> None:
        """On a fresh machine the filter compiles first."""
        wait(condition, timeout, lambda: self.executor.spin_once(timeout_sec=0.01))

    def connected(self) -> bool:
        """Both ways: a filter that reports has seen this participant too."""
        matched = self.states.get_subscription_count() > 0 and self._answers.get_publisher_count() > 0
        return matched and len(self.diagnostics) > 0

    def publish(self, sequence: int, sample: Sample, age: float | None = None, flags: int = 1) -> None:
        """A sample of a plant that goes by its own clock, or in real time: then it is `age` [s] old."""
        values = dict(zip(PLANT_FIELDS, sample.state, strict=True))
        values |= {"nominal_valve_current": sample.nominal_current, "reference_force": sample.reference_force}
        values |= {"proportional_gain": sample.proportional_gain, "valve_current": sample.valve_current}
        values |= {"reference_force_rate": sample.reference_rate}
        numbers = [float(values.get(name, 0.0)) for name in STATE_FIELDS]
        flags |= Flag.PACED if age is None else 0
        self.states.publish(STATES.pack(time.time_ns() - round(1e9 * (age or 0.0)), sequence, *numbers, flags))

    def ask(self, sequence: int, sample: Sample, *, flags: int = 1, timeout: float = 150.0) -> Correction:
        """Publish a state and return its correction."""
        before = len(self.corrections)
        self.publish(sequence, sample, flags=flags)
        self.wait(lambda: len(self.corrections) > before, timeout)
        return self.corrections[-1]

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def listening() -> Source:
    """A source that the filter of this domain has met."""
    source = Source()
    source.wait(source.connected)
    return source


@pytest.fixture
def started(start: Callable[..., Companion]) -> Iterator[Callable[..., Source]]:
    """Start a filter with some arguments; gives the source that it listens to."""
    with ExitStack() as stack:

        def begin(*arguments: str) -> Source:
            start("hydro_filter filter", *arguments)
            source = listening()
            stack.callback(source.close)
            return source

        yield begin


@pytest.fixture(scope="module")
def domain_of_shared() -> Iterator[str]:
    """Domain of one filter for all tests that leave it as it was."""
    with reserved_domain() as domain, ExitStack() as stack:
        with patch.dict(os.environ, {"ROS_DOMAIN_ID": domain}):
            stack.enter_context(Companion("hydro_filter", "filter", []))
        yield domain


@pytest.fixture
def source(domain_of_shared: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Source]:
    """A plant that has just come to the shared filter."""
    monkeypatch.setenv("ROS_DOMAIN_ID", domain_of_shared)
    made = listening()
    yield made
    made.close()


@pytest.fixture(scope="module")
def unstable() -> Sample:
    """A bench at rest, far from its reference, under a gain that the filter corrects."""
    return Sample(AnalyticPlant(Bench.nominal(), noise=0.0).reset(0), 0.0, 100.0, -40.0)


def test_a_backlog_of_old_states_is_answered_stale_each_once(started: Callable[..., Source], unstable: Sample) -> None:
    source = started()
    for k in range(40):
        source.publish(k, unstable, age=0.05)
    source.wait(lambda: len(source.corrections) >= 40)
    assert [message.sequence for message in source.corrections] == list(range(40))
    assert {(message.status, message.delta_u) for message in source.corrections} == {(CorrectionStatus.STALE, 0.0)}


def test_bypass_is_loud(started: Callable[..., Source], unstable: Sample) -> None:
    source = started("--bypass")
    answer = source.ask(0, unstable)
    assert (answer.status, answer.delta_u) == (CorrectionStatus.BYPASSED, 0.0)
    assert answer.certificate_before > 0.0
    source.wait(lambda: any("BYPASSED" in status.message for status in source.diagnostics))
    assert source.diagnostics[-1].level == DiagnosticStatus.ERROR


@pytest.fixture
def beside_the_law(started: Callable[..., Source], model: Bench, metric: ScheduledMetric, tmp_path: Path) -> Source:
    """A filter that is made for both laws."""
    file, of = tmp_path / "metric.safetensors", tmp_path / "model.yaml"
    of.write_text(yaml.safe_dump(model.to_mapping()))
    replace(metric, made=MadeFor(box=Bench.nominal().digest, model=digest_of(of))).save(file)
    return started("--metric", str(file), "--model", str(of))


def test_new_files_are_taken_over_while_disarmed_and_not_before(
    started: Callable[..., Source], model: Bench, metric: ScheduledMetric, tmp_path: Path
) -> None:
    """The filter is of another spring: MISMATCH, until model and metric of this bench are there and it is disarmed."""
    bench, file, of = Bench.nominal(), tmp_path / "metric.safetensors", tmp_path / "model.yaml"
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
    schedule = Schedule(reference=signal, gains=(75.0, 10.0), seconds=1.0)
    records = simulate(AnalyticPlant(model), bench, schedule, seed=1)

    def write(own: Bench) -> None:
        of.write_text(yaml.safe_dump(own.to_mapping()))
        replace(metric, made=MadeFor(box=bench.digest, model=digest_of(of))).save(file)

    def play(flags: int = 1) -> CorrectionStatus:
        answers = [source.ask(next(number), Sample.from_record(record), flags=flags) for record in records]
        return CorrectionStatus(answers[-1].status & STATUS_MASK)

    write(replace(model, spring_stiffness=1.5 * model.spring_stiffness))
    source, number = started("--metric", str(file), "--model", str(of)), itertools.count()
    before = dict_of(source.diagnostics[-1])["model"]
    assert play() == CorrectionStatus.MISMATCH
    write(model)
    for _ in range(2):
        time.sleep(2.5)  # as a machine that is busy: samples wait, and the plant is armed all the while
        assert play() == CorrectionStatus.MISMATCH, "it is armed"
    assert dict_of(source.diagnostics[-1])["model"] == before
    source.wait(lambda: play(flags=0) is not None and dict_of(source.diagnostics[-1])["model"] != before)
    assert play() != CorrectionStatus.MISMATCH
    taken = dict_of(source.diagnostics[-1])["model"]
    of.write_text(yaml.safe_dump(replace(model, moving_mass=2.0 * model.moving_mass).to_mapping()))  # no metric of it
    for _ in range(4):
        play(flags=0)
    assert dict_of(source.diagnostics[-1])["model"] == taken


def test_under_the_compensated_law_a_sample_waits_for_its_law_and_is_stale_if_it_does_not_come(
    beside_the_law: Source, model: Bench, metric: ScheduledMetric, unstable: Sample
) -> None:
    """At C_1 = 1 and a gain that is not certified there; the law before its sample, or behind it."""
    source, core = beside_the_law, loop_filter(metric, model, Bench.nominal())
    laws = create_publisher(source.node, LAW_STATE)
    source.wait(lambda: laws.get_subscription_count() > 0)
    law = LawState(Law.COMPENSATED, 100.0, 0.0, (1.0, 0.0, 0.0, 0.0), 1.0, 1.0)
    sample = unstable._replace(proportional_gain=300.0, law=law)
    expected: list[tuple[int, CorrectionStatus, float]] = []
    laws.publish(pack_law_state(0, 2**32 - 1, law))
    told = len(source.diagnostics)
    source.wait(lambda: len(source.diagnostics) > told + 1)  # by then it has heard of the law
    for sequence in range(10):
        if sequence == 5:
            source.publish(sequence, sample)
            core.reset_history()
            expected.append((sequence, CorrectionStatus.STALE, 0.0))
            continue
        turns = [lambda k=sequence: laws.publish(pack_law_state(0, k, law)),
                 lambda k=sequence: source.publish(k, sample)]  # fmt: skip
        for turn in turns if sequence % 2 else turns[::-1]:
            turn()
        source.wait(lambda wanted=sequence + 1: len(source.corrections) >= wanted, timeout=5.0)
        result = core.correct(sample)
        expected.append((sequence, result.status, pytest.approx(result.delta_u, abs=1e-9)))
    assert [(one.sequence, one.status, one.delta_u) for one in source.corrections] == expected
    assert CorrectionStatus.MODIFIED in {status for _, status, _ in expected}
    c_1 = BoxConfig().compensated.velocity_compensation
    assert f"K_p 15 to 400 1/s at C_1 = {c_1:g}" in dict_of(source.diagnostics[-1])["certified"]
    laws.publish(LawStateMessage(sequence=10, law=7))
    source.publish(10, sample)
    source.wait(lambda: "law 7 is unknown" in source.diagnostics[-1].message)
    assert source.corrections[-1].status == CorrectionStatus.BYPASSED
    assert source.diagnostics[-1].level == DiagnosticStatus.WARN


def test_a_plant_that_goes_by_its_own_clock_has_no_stale_states(
    started: Callable[..., Source], start: Callable[..., Companion]
) -> None:
    """Its stamps count from its start; nobody told the filter."""
    source = started()
    source.node.destroy_publisher(source.states)  # two plants are not answered
    start("hydro_sim sim")
    source.wait(lambda: any(message.status & STATUS_MASK == CorrectionStatus.PASS for message in source.corrections))
    before = len(source.corrections)
    source.wait(lambda: len(source.corrections) > before + 500)
    later = [message.status & STATUS_MASK for message in source.corrections[before:]]
    assert later.count(CorrectionStatus.PASS) == len(later)


def test_every_state_gets_one_correction_with_the_cores_numbers_and_a_gap_a_new_beginning(
    started: Callable[..., Source], unstable: Sample
) -> None:
    """A run of the emulated bench's analytic kin under gains that have to be corrected, ten samples of it left out."""
    lenient = ("--innovation-limit", "10")  # the kin has no spool: not the learned bench
    source, core = started("--metric", "learned", *lenient), FilterChoice(bench=Bench.nominal())
    contraction_filter = core.make(LoopFilterSettings(innovation_limit=10.0))
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=4.0)
    schedule = Schedule(reference=signal, gains=(-5.0, 0.0), seconds=0.4)
    records = simulate(AnalyticPlant(Bench.nominal()), Bench.nominal(), schedule, seed=3)
    seen, first = set(), 2**32 - 100  # the sequence wraps under way
    for k, record in enumerate(records):
        if 200 <= k < 210:
            continue
        sample, sequence = Sample.from_record(record), (first + k) % 2**32
        message = source.ask(sequence, sample, timeout=5.0)
        if k == 210:
            contraction_filter.reset_history()
        expected = contraction_filter.correct(sample)
        assert (message.sequence, message.status & STATUS_MASK) == (sequence, expected.status)
        assert message.delta_u == pytest.approx(expected.delta_u, abs=1e-9)
        assert message.certificate_before == pytest.approx(expected.before, rel=1e-9, abs=1e-12)
        assert message.active == (message.delta_u != 0.0)
        seen.add(expected.status)
    assert seen >= {CorrectionStatus.PASS, CorrectionStatus.MODIFIED}
    source.wait(lambda: any("sha256" in dict_of(status).get("metric", "") for status in source.diagnostics))
    assert "learned_bench.yaml, sha256" in dict_of(source.diagnostics[-1])["model"]
    assert len(source.corrections) == len(records) - 10, "no second answer to anything"
    source.publish((first + len(records)) % 2**32, unstable._replace(reference_force=math.nan))
    source.wait(lambda: source.diagnostics[-1].level == DiagnosticStatus.WARN)
    assert source.corrections[-1].status == CorrectionStatus.NAN and "1 nan" in source.diagnostics[-1].message


def test_a_box_that_believes_another_bench_gets_no_correction_until_it_fits_again(
    source: Source, unstable: Sample
) -> None:
    told = create_publisher(source.node, BOX)
    own, fits = Bench.nominal().digest, CorrectionStatus.MODIFIED
    boxes = ((own, fits), ("0123456789ab", CorrectionStatus.MISMATCH), ("", fits), (own, fits))
    for turn, (digest, status) in enumerate(boxes):
        told.publish(BoxInfo(plant="bridge", bench_digest=digest))
        sequence = 1000 * turn

        def answered(status: CorrectionStatus = status) -> bool:
            nonlocal sequence
            source.publish(sequence, unstable)
            sequence += 1
            return bool(source.corrections) and source.corrections[-1].status & STATUS_MASK == status

        source.wait(answered, timeout=30.0)
        last = source.corrections[-1]
        if status == CorrectionStatus.MISMATCH:
            assert last.delta_u == 0.0 and not last.active and math.isnan(last.certificate_after)
            source.wait(lambda: "nothing is corrected: the filter was started for" in source.diagnostics[-1].message)
            assert source.diagnostics[-1].level == DiagnosticStatus.ERROR
        else:
            assert last.delta_u > 0.0 and last.certificate_before > 0.0
    source.node.destroy_publisher(told)


def test_a_bench_that_is_not_the_models_is_told_in_every_correction_and_in_diagnostics(
    started: Callable[..., Source],
) -> None:
    """A stiffer spring from the beginning; with another box what was told of it is over, with the same again it stays.

    Each sample waits for its answer, so that the age is no matter.
    """
    source = started("--metric", "learned")
    truth = modified_truth({"bench": {"spring_stiffness": 3e4}})
    records = record_offline(truth, [Segment(seconds=1.0, amplitude=300.0, frequency=1.0)]).states
    answers = [source.ask(k, Sample.from_record(record), timeout=5.0) for k, record in enumerate(records)]
    statuses = [message.status & STATUS_MASK for message in answers]
    first = statuses.index(CorrectionStatus.MISMATCH)
    assert set(statuses[first:]) == {CorrectionStatus.MISMATCH}
    assert all(message.delta_u == 0.0 and not message.active for message in answers[first:])
    source.wait(lambda: "MISMATCH" in source.diagnostics[-1].message)
    assert source.diagnostics[-1].level == DiagnosticStatus.ERROR
    source.wait(lambda: dict_of(source.diagnostics[-1]).get("mismatch") == str(len(statuses) - first))
    told = dict_of(source.diagnostics[-1])
    assert "the model's load (the spring or its load cell) is off by" in told["fits"]
    latched, still, sequence = create_publisher(source.node, BOX), Sample.from_record(records[0]), len(records)
    for plant, firmware, mismatched in (("bridge", "one", True), ("sim", "one", True), ("sim", "another", False)):
        latched.publish(BoxInfo(plant=plant, firmware=firmware))  # again, by whichever node; then another box
        for _ in range(20):
            sequence += 1
            answer = source.ask(sequence, still, timeout=5.0)
            time.sleep(0.01)
        assert (answer.status == CorrectionStatus.MISMATCH) is mismatched, firmware
    source.node.destroy_publisher(latched)


def test_two_plants_are_an_error_and_not_answered(source: Source, unstable: Sample) -> None:
    rival = create_publisher(source.node, STATE)
    source.wait(lambda: "2 nodes publish /hydro/state" in source.diagnostics[-1].message)
    assert source.diagnostics[-1].level == DiagnosticStatus.ERROR
    heard = len(source.corrections)
    source.publish(1, unstable)
    told = len(source.diagnostics)
    source.wait(lambda: len(source.diagnostics) > told + 1)
    assert len(source.corrections) == heard, "which of them is the plant's?"
    source.node.destroy_publisher(rival)


def dict_of(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_outside_of_the_proved_region_is_said_beside_the_status(source: Source) -> None:
    """The shipped statement of the paper's law is of sines of 100 N, 1 Hz, and of gains that change slowly."""
    bench, number = Bench.nominal(), itertools.count()

    def outside(amplitude: float, proportional_gain: float) -> list[bool]:
        signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=1.0)
        plan = Schedule(reference=signal, gains=(90.0, 15.0), seconds=1.5)
        said = []
        for index, record in enumerate(simulate(AnalyticPlant(learned_bench.load_model()), bench, plan, seed=0)):
            sample = Sample.from_record(record)
            if 1200 <= index < 1300:
                sample = sample._replace(proportional_gain=proportional_gain)
            status = source.ask(next(number), sample, flags=int(record["flags"]) | Flag.ARMED).status
            assert CorrectionStatus(status & STATUS_MASK) <= CorrectionStatus.INFEASIBLE
            said.append(bool(status & OUTSIDE_REGION))
        return said

    assert not any(outside(100.0, 90.0)[1000:])
    assert any(outside(300.0, 90.0)[1000:])
    changed = outside(100.0, 80.0)
    assert sum(changed[1000:]) == 20, "ten samples each: the gain steps away, and back"
    source.wait(lambda: int(dict_of(source.diagnostics[-1])["outside"]) >= 20)
