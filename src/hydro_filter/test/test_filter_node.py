# SPDX-License-Identifier: Apache-2.0
"""The running node: one Correction for each BenchState, with the numbers of the core."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

pytest.importorskip("hydro_msgs.msg", reason="source install/setup.bash")

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.messages import STATE_CODEC, pack_law_state
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
from hydro_core.signals import CorrectionStatus, Flag, Law, ReferenceSignal, Waveform
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_filter
from hydro_filter.controller.osqp_solver import OsqpSolver
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.sample import Sample
from hydro_filter.nodes.filter import FilterNode
from hydro_msgs.msg import BoxInfo, Correction
from hydro_msgs.msg import LawState as LawStateMessage
from hydro_sim.box.box import BoxConfig
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import Provenance
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.checks import wait

pytestmark = pytest.mark.graph

NOMINAL = Bench.nominal()
UNSTABLE = Sample(AnalyticPlant(NOMINAL, noise=0.0).reset(0), 0.0, 100.0, -40.0)
"""A bench at rest, far from its reference, under a gain that the filter corrects."""
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)


class Source:
    """Publishes states as a plant does, and keeps the corrections that come back; made once it has met the filter."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("source", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.corrections: list[Correction] = []
        self.diagnostics: list[DiagnosticStatus] = []
        self.states = create_publisher(self.node, STATE)
        answers = create_subscription(self.node, CORRECTION, self.corrections.append)
        create_subscription(self.node, DIAGNOSTICS, lambda array: self.diagnostics.extend(array.status))
        self.wait(  # a filter that reports has seen this participant too
            lambda: self.states.get_subscription_count() and answers.get_publisher_count() and self.diagnostics
        )

    def wait(self, condition: Callable[[], object], timeout: float = 150.0) -> None:
        """On a fresh machine the filter compiles first."""
        wait(condition, timeout, lambda: self.executor.spin_once(timeout_sec=0.01))

    def publish(self, sequence: int, sample: Sample, age: float | None = None, flags: int = 1) -> None:
        """A sample that is `age` [s] old, or one of a plant whose own clock counts from its start."""
        numbers = [*sample.state.tolist(), sample.valve_current, sample.nominal_current, sample.reference_force]
        numbers += [sample.reference_rate, sample.proportional_gain, 0.0]
        stamp = 1_000_000 * sequence if age is None else time.time_ns() - round(1e9 * age)
        self.states.publish(STATE_CODEC.pack(stamp, sequence, *numbers, flags | (Flag.PACED if age is None else 0)))

    def ask(self, sequence: int, sample: Sample, *, flags: int = 1, timeout: float = 150.0) -> Correction:
        """Publish a state and return its correction."""
        before = len(self.corrections)
        self.publish(sequence, sample, flags=flags)
        self.wait(lambda: len(self.corrections) > before, timeout)
        return self.corrections[-1]

    @property
    def said(self) -> dict[str, str]:
        """Values of the latest diagnostics."""
        return {pair.key: pair.value for pair in self.diagnostics[-1].values}

    def told(self, words: str, level: bytes = DiagnosticStatus.ERROR) -> None:
        """Wait until the diagnostics say so, at this level."""
        self.wait(lambda: words in self.diagnostics[-1].message)
        assert self.diagnostics[-1].level == level

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


Started = Callable[..., Source]


@pytest.fixture
def started(start: Callable[..., Companion]) -> Iterator[Started]:
    """Start a filter with some arguments; gives the source that it listens to."""
    with ExitStack() as stack:

        def begin(*arguments: str) -> Source:
            start("hydro_filter filter", *arguments)
            source = Source()
            stack.callback(source.close)
            return source

        yield begin


def written(folder: Path, model: Bench, metric: ScheduledMetric) -> tuple[str, ...]:
    """Words of a filter of these, which are written to files."""
    file, of = folder / "metric.safetensors", folder / "model.yaml"
    of.write_text(yaml.safe_dump(model.to_mapping()))
    replace(metric, provenance=Provenance(box=NOMINAL.digest, model=learned_bench.digest(of))).save(file)
    return "--metric", str(file), "--model", str(of)


def test_a_backlog_of_old_states_is_answered_stale_each_once(started: Started) -> None:
    source = started()
    for k in range(40):
        source.publish(k, UNSTABLE, age=0.05)
    source.wait(lambda: len(source.corrections) >= 40)
    assert [message.sequence for message in source.corrections] == list(range(40))
    assert {(message.status, message.delta_u) for message in source.corrections} == {(CorrectionStatus.STALE, 0.0)}


def test_bypass_is_loud(started: Started) -> None:
    source = started("--bypass")
    answer = source.ask(0, UNSTABLE)
    assert (answer.status, answer.delta_u) == (CorrectionStatus.BYPASSED, 0.0)
    assert answer.certificate_before > 0.0
    source.told("BYPASSED")


def test_a_mismatch_is_told_until_another_box_comes_or_new_files_while_it_is_disarmed(
    started: Started, model: Bench, metric: ScheduledMetric, tmp_path: Path
) -> None:
    """The filter is of another spring than the bench."""
    plan = Schedule(reference=SINE, gains=(75.0, 10.0), seconds=1.0)
    records = [Sample.from_record(one) for one in simulate(AnalyticPlant(model), NOMINAL, plan, seed=1)]
    words = written(tmp_path, replace(model, spring_stiffness=1.5 * model.spring_stiffness), metric)
    source, number = started(*words), itertools.count()

    def play(flags: int = 1) -> list[Correction]:
        return [source.ask(next(number), record, flags=flags) for record in records]

    def mismatched(answer: Correction) -> bool:
        return answer.status == CorrectionStatus.MISMATCH

    told = list(itertools.dropwhile(lambda answer: not mismatched(answer), play()))
    assert told and all(mismatched(answer) and answer.delta_u == 0.0 and not answer.active for answer in told)
    source.told("MISMATCH")
    source.wait(lambda: source.said.get("mismatch") == str(len(told)))
    assert "the model's load (the spring or its load cell) is off by" in source.said["fits"]
    boxes = create_publisher(source.node, BOX)
    for plant, firmware, stays in (("bridge", "one", True), ("sim", "one", True), ("sim", "another", False)):
        boxes.publish(BoxInfo(plant=plant, firmware=firmware))  # again, by whichever node; then another box
        for _ in range(20):
            answer = source.ask(next(number), records[0])
            time.sleep(0.01)
        assert mismatched(answer) is stays, firmware
    assert mismatched(play()[-1])
    before = source.said["model"]
    written(tmp_path, model, metric)
    for _ in range(2):
        time.sleep(2.5)  # as a machine that is busy: samples wait, and the plant is armed all the while
        assert mismatched(play()[-1]), "it is armed"
    assert source.said["model"] == before
    source.wait(lambda: play(flags=0) and source.said["model"] != before)
    assert not mismatched(play()[-1])
    taken = source.said["model"]
    heavier = replace(model, moving_mass=2.0 * model.moving_mass)  # no metric of it
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(heavier.to_mapping()))
    for _ in range(4):
        play(flags=0)
    assert source.said["model"] == taken


def test_under_the_compensated_law_a_sample_waits_for_its_law_and_is_stale_if_it_does_not_come(
    started: Started, model: Bench, metric: ScheduledMetric, tmp_path: Path
) -> None:
    """At C_1 = 1 and a gain that is not certified there; the law before its sample, or behind it."""
    source, core = started(*written(tmp_path, model, metric)), loop_filter(metric, model, NOMINAL)
    laws = create_publisher(source.node, LAW_STATE)
    source.wait(lambda: laws.get_subscription_count() > 0)
    law = LawState(Law.COMPENSATED, 100.0, 0.0, (1.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0)
    sample = UNSTABLE._replace(proportional_gain=300.0, law=law)
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
        if sequence % 2:
            laws.publish(pack_law_state(0, sequence, law))
        source.publish(sequence, sample)
        if not sequence % 2:
            laws.publish(pack_law_state(0, sequence, law))
        source.wait(lambda wanted=sequence + 1: len(source.corrections) >= wanted)
        result = core.correct(sample)
        expected.append((sequence, result.status, pytest.approx(result.delta_u, abs=1e-9)))
    assert [(one.sequence, one.status, one.delta_u) for one in source.corrections] == expected
    assert CorrectionStatus.MODIFIED in {status for _, status, _ in expected}
    c_1 = BoxConfig().compensated.velocity_compensation
    assert f"K_p 15 to 400 1/s at C_1 = {c_1:g}" in source.said["certified"]
    laws.publish(LawStateMessage(sequence=10, law=7))
    source.publish(10, sample)
    source.told("law 7 is unknown", DiagnosticStatus.WARN)
    assert source.corrections[-1].status == CorrectionStatus.BYPASSED


def test_every_state_gets_one_correction_with_the_cores_numbers_and_a_gap_a_new_beginning(started: Started) -> None:
    """A run of the emulated bench's analytic kin under gains that have to be corrected, ten samples of it left out."""
    source = started("--innovation-limit", "10")  # the kin has no spool: not the learned bench
    core = FilterChoice(bench=NOMINAL).make(LoopFilterSettings(innovation_limit=10.0))
    schedule = Schedule(reference=replace(SINE, frequency=4.0), gains=(-5.0, 0.0), seconds=0.4)
    records = simulate(AnalyticPlant(NOMINAL), NOMINAL, schedule, seed=3)
    seen, first = set(), 2**32 - 100  # the sequence wraps under way
    for k, record in enumerate(records):
        if 200 <= k < 210:
            continue
        sample, sequence = Sample.from_record(record), (first + k) % 2**32
        message = source.ask(sequence, sample, timeout=5.0)
        if k == 210:
            core.reset_history()
        expected = core.correct(sample)
        assert (message.sequence, message.status) == (sequence, expected.status)
        assert message.delta_u == pytest.approx(expected.delta_u, abs=1e-9)
        assert message.certificate_before == pytest.approx(expected.before, rel=1e-9, abs=1e-12)
        assert message.active == (message.delta_u != 0.0)
        seen.add(expected.status)
    assert seen >= {CorrectionStatus.PASS, CorrectionStatus.MODIFIED}
    assert "sha256" in source.said["metric"] and "learned_bench.yaml, sha256" in source.said["model"]
    assert len(source.corrections) == len(records) - 10, "no second answer to anything"
    source.publish((first + len(records)) % 2**32, UNSTABLE._replace(reference_force=math.nan))
    source.told("1 nan", DiagnosticStatus.WARN)
    assert source.corrections[-1].status == CorrectionStatus.NAN


def test_a_box_that_believes_another_bench_gets_no_correction_until_it_fits_again(started: Started) -> None:
    source, number = started(), itertools.count()
    boxes, fits = create_publisher(source.node, BOX), CorrectionStatus.MODIFIED
    for digest, status in ((NOMINAL.digest, fits), ("0123456789ab", CorrectionStatus.MISMATCH), ("", fits)):
        boxes.publish(BoxInfo(plant="bridge", bench_digest=digest))
        source.wait(lambda wanted=status: source.ask(next(number), UNSTABLE).status == wanted, 30.0)
        last = source.corrections[-1]
        if status == fits:
            assert last.delta_u > 0.0 and last.certificate_before > 0.0
        else:
            assert last.delta_u == 0.0 and not last.active and math.isnan(last.certificate_after)
            source.told("nothing is corrected: the filter was started for")


def test_two_plants_are_an_error_and_not_answered(started: Started) -> None:
    source = started()
    create_publisher(source.node, STATE)
    source.told("2 nodes publish /hydro/state")
    heard, told = len(source.corrections), len(source.diagnostics)
    source.publish(1, UNSTABLE)
    source.wait(lambda: len(source.diagnostics) > told + 1)
    assert len(source.corrections) == heard, "which of them is the plant's?"


def test_a_solver_that_takes_too_long_is_answered_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    rclpy.init()
    choice, settings = FilterChoice(bench=NOMINAL), LoopFilterSettings(solver="osqp", state_age_max=0.1)
    node = FilterNode(choice, settings, in_process=True)
    numbers = [*UNSTABLE.state.tolist(), 0.0, 0.0, UNSTABLE.reference_force, 0.0, UNSTABLE.proportional_gain, 0.0]
    try:
        assert node.correct(STATE_CODEC.record(time.time_ns(), 0, *numbers, 1), None, 1).status == (
            CorrectionStatus.MODIFIED
        )
        monkeypatch.setattr(OsqpSolver, "solve", lambda self, *program: time.sleep(0.11) or 0.01)
        late = node.correct(STATE_CODEC.record(time.time_ns(), 1, *numbers, 1), None, 1)
        assert (late.status, late.delta_u) == (CorrectionStatus.STALE, 0.0)
    finally:
        node.destroy_node()
        rclpy.shutdown()
