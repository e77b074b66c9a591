# SPDX-License-Identifier: Apache-2.0
"""The ROS node of trainer, evaluate, collect and commission: states in; gains, reference and arming out.

It offers two services to a person: manual override of the gains (/hydro/override), freezing of the coefficients.
"""

from __future__ import annotations

import math
import os
import queue
import signal
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from std_srvs.srv import SetBool

from hydro_bridge.plant_clock import COMMANDER_WINDOW
from hydro_bridge.ros.acknowledgement import SampleAcknowledger
from hydro_bridge.ros.commander import LEASE_WAIT_MAX, Commander
from hydro_bridge.ros.companion import Companion, CompanionError, RecorderMonitor
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, RosoutLogger, Status, publisher_conflicts
from hydro_bridge.ros.messages import (
    CORRECTION_CODEC,
    LAW_STATE_CODEC,
    STATE_CODEC,
    seconds,
    subscribe,
    subscribe_to_box,
)
from hydro_bridge.ros.node import request_realtime, spin
from hydro_bridge.ros.topics import (
    BOX_LAW,
    CORRECTION,
    FREEZE_SERVICE,
    LAW_STATE,
    OVERRIDE_SERVICE,
    POLICY,
    RECORDED_TOPICS,
    STATE,
    Mailbox,
    create_publisher,
    create_subscription,
)
from hydro_bridge.safety.box_info import BoxDescription, box_info_requirement
from hydro_bridge.safety.lease import DISARMED_BY_PERSON
from hydro_bridge.safety.readiness import NotReadyError, Readiness, Requirement
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.bench_scales import BenchScales
from hydro_core.process import termination
from hydro_core.process.realtime import Latency, drop_realtime
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_FIELDS, Flag, ReferenceSignal
from hydro_msgs.msg import BoxLaw as BoxLawMessage
from hydro_msgs.msg import PolicyStep
from hydro_msgs.srv import OverrideGains
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.runner import Session
from hydro_policy.nodes.announcements import Announcer, CompanionWatch, terminal_lines
from hydro_policy.supervision import plant_supervisor
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.model.bench import NOMINAL

_SAMPLE_SLICE = slice(2, 2 + len(STATE_FIELDS))  # of a state's record, behind stamp and sequence
_STEP_PERIOD = SAMPLES_PER_STEP * SAMPLE_PERIOD  # s, of a policy step


@dataclass
class GainTiming:
    """Latencies of policy steps."""

    response: Latency = field(default_factory=Latency)  # from a sample's arrival in this process to the gains' leaving
    age: Latency = field(default_factory=Latency)  # from the sample's stamp to the gains' stamp: total latency
    jitter: Latency = field(default_factory=Latency)
    """|interval between gains - 10 ms|; pauses of five intervals or more are excluded."""
    published: float = 0.0  # time of the last gains, s

    def add(self, arrived: float, published: float, age: float) -> None:
        """Count one step: a sample's arrival and the gains' publication [s, monotonic], and their age [s]."""
        self.response.add(published - arrived)
        self.age.add(age)
        interval, self.published = published - self.published, published
        if interval < 5 * _STEP_PERIOD:
            self.jitter.add(abs(interval - _STEP_PERIOD))


class CleanupStack(ExitStack):
    """Exit stack of a run's clean-up calls, which signals do not interrupt."""

    def __exit__(self, *error: Any) -> bool | None:
        """Run the clean-up calls, the last first, with signals ignored."""
        with termination.signals_ignored():
            return super().__exit__(*error)


TICK_PERIOD = 0.05  # s
NICENESS = -15
"""Niceness: before all ordinary processes, after bridge and filter, whose deadline is 1 ms; that of gains is 10 ms."""


SILENCE_MAX = 60.0  # s of wall clock without a sample after which the time of a plant on its own clock advances anyway
_TICK_SAMPLES = round(TICK_PERIOD / SAMPLE_PERIOD)


class GraphNode(Node):
    """ROS node between the graph and one session at a time; implements `supervision.plant_supervisor.Outputs`.

    It commands the plant only while it holds the lease: a new node waits, and sends nothing, as long as the plant
    reports another holder. States of two plants are ignored.

    A plant on its own clock waits for the answer to each policy step. It is sent, with the step's commands, once the
    session has processed the step and a tick that is due, the plant has answered all requests, and recorder and learner
    are ready.

    `name`: name of the node. `realtime`: request SCHED_FIFO while a session runs; processes started then (a restarted
    learner) stay ordinary. `lease_wait_max`: longest wait for another node's lease on the plant, s.
    """

    def __init__(self, name: str, *, realtime: bool = True, lease_wait_max: float = LEASE_WAIT_MAX) -> None:
        super().__init__(name)
        journal = RosoutLogger(self)
        self.announcer, self._log_call = Announcer(journal.log), journal.log_call
        self._realtime, self._scheduling = realtime, ""
        self.companions = CompanionWatch([])
        self.requirements: list[Requirement] = []
        """Requirements of this node's sessions before arming, besides those of every session."""
        self.corrected = False  # whether a correction has arrived since `listen_to_corrections`
        self.timing = GainTiming()
        self.override = GainOverride(report=self.warn)
        self.box: BoxDescription | None = None  # description of the plant's box, once received
        self.box_fault: Callable[[BoxDescription], str] = lambda box: ""
        """Function that returns why a box is not the expected one, or an empty text; called at each box description."""
        self.law: BoxLaw | None = None  # the box's compensated law, once received; None: not yet, or it has none
        self.compensation: LiveCompensation | None = None
        """Estimator that follows the box's compensated law; see `compensate`."""
        self.load_force_file: Path | None = None
        """File of the forces on an emulated load (`hydro_sim.files.load_force`), if there is one."""
        self.ended = 0  # sequence of the sample that ended the last session
        self._session: Session | None = None
        self._meeting: Readiness | None = None  # while waiting for a plant to describe its box
        self._readiness = Readiness([], self.warn)  # of what a session awaits by the wall clock
        self._each_tick: Callable[[], None] = lambda: None
        self._done = Future()
        self._failure: Exception | None = None
        self._heard: Any = None  # last sample
        self._arrived = self._sampled = math.inf  # when the last sample came, and the first, s
        self._laws_told = False
        self._unhandled: list[tuple[Any, float]] = []  # samples while no session runs, with their arrival [s]
        self._owed: int | None = None  # sample whose answer is due to a plant that waits
        self._early: list[Any] = []  # corrections of samples that were not handled yet
        self._two_plants, self._crowd = False, ""  # whether two plants sent samples since the last tick; last warning
        self._unarmed_since = math.inf  # start of the plant's refusal to be armed, s
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._gains_out = 0.0
        self._step = PolicyStep()  # one object, used again a hundred times a second
        self._steps: Publisher | None = None
        self._override_service: Service | None = None  # only with the lease: the next holder offers its own
        end = partial(os.kill, os.getpid(), signal.SIGINT)  # as Ctrl-C does
        self._commander = Commander(self, self._on_lease, end, self.warn, lease_wait_max)
        self._commander.on_answer, self._commander.stamp = self._answer, self._stamp
        self.publish_law, self.publish_reference = self._commander.publish_law, self._commander.publish_reference
        self._states = subscribe(self, STATE, STATE_CODEC, self._on_state)
        self._mailbox = Mailbox(name)
        self._corrections: Subscription | None = None  # read at each policy step
        self._answers = SampleAcknowledger(self, COMMANDER_WINDOW, self._states)
        subscribe_to_box(self, self._on_box)
        create_subscription(self, BOX_LAW, self._on_box_law)
        self.create_timer(TICK_PERIOD, self._on_tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def supervisor(
        self, *needed: Requirement, rearm: bool, after: PlantSupervisor | None = None, filtered: bool = True
    ) -> PlantSupervisor:
        """Return a supervisor of the plant for a session; `needed`: further requirements before arming.

        `after`: supervisor of the previous session, whose plant is taken over as it is. `filtered`: see
        `PlantSupervisor`.
        """
        made = PlantSupervisor(self, rearm, (*self.requirements, *needed), self.override, filtered=filtered)
        if after is not None:
            made.continue_from(after)
        return made

    def watch_companions(self, companions: list[Companion], recording: Path | None) -> None:
        """Watch these companions; arming requires that the recorder of `recording` receives samples."""
        self.companions = CompanionWatch(companions)
        for companion in companions:
            if recording is not None and companion.name == "recorder":
                self.companions.recording = "runs"
                self.requirements.append(RecorderMonitor(self, recording, companion).requirement)

    def wait_for_plant(self, *, law: bool = False) -> bool:
        """Wait for a plant that describes its box, and check that it is the expected one; False after a signal.

        Nothing is published and nothing is armed meanwhile. `law`: wait for the description of its force laws, too.

        Raises CompanionError: the box is not the expected one, or a companion rejected its input or has ended;
        NotReadyError: no plant appeared in time, or its box was not described.
        """
        needed = (
            plant_supervisor.plant_requirement(lambda: self._sampled < math.inf),
            box_info_requirement(lambda: self.box is not None and self._laws_told),
        )
        self._laws_told |= not law
        self._meeting, self._done = Readiness(needed, self.warn), Future()
        if self.box is not None:
            self._on_box(self.box)
        try:
            return self._spin()
        finally:
            self._meeting = None

    def run_session(self, session: Session, each_tick: Callable[[], None]) -> bool:
        """Run `session` until it is finished (True) or a signal arrives (False); `each_tick` is called every 50 ms.

        Raises CompanionError: a companion rejected its input, an essential companion has ended, or the box is another
        one; NotReadyError: a requirement for arming was not met in time.
        """
        self._raise_failure()
        self._session, self._each_tick, self._done = session, each_tick, Future()
        needed = (requirement for requirement in session.supervisor.readiness.requirements if requirement.by_wall_clock)
        self._readiness = Readiness(tuple(needed), self.warn)
        scheduling = request_realtime(realtime=self._realtime and not self.paced, nice=NICENESS)
        if scheduling != self._scheduling:
            self.report(f"gains are sent under {scheduling}")
            self._scheduling = scheduling
        try:
            unhandled, self._unhandled = self._unhandled, []
            if self.paced:  # it has waited since the session before, and is answered now
                if self._owed is not None:
                    self._tick(session, self.now())
                for message, arrived in unhandled:
                    self._handle(session, message, arrived)
                self._answer()
            return self._spin()
        finally:
            self._session = None
            drop_realtime()

    def _spin(self) -> bool:
        """Run until done; returns False after a signal, and raises the error by which it was ended."""
        broken = spin(self, self._done)
        self._raise_failure()
        return not broken

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def fail(self, error: Exception) -> None:
        """End the session with an error, raised by the call that spins: in a callback rclpy would print it, too."""
        self._failure = self._failure or error
        self._finish()

    def _finish(self) -> None:
        if not self._done.done():
            self._done.set_result(None)

    @property
    def paced(self) -> bool:
        """Whether the plant runs on its own clock."""
        return self._heard is not None and bool(self._heard.flags & Flag.PACED)

    @property
    def armed(self) -> bool:
        """Whether the last sample was armed."""
        return self._heard is not None and bool(self._heard.flags & Flag.ARMED)

    def now(self) -> float:
        """Return the session's time [s]: of the monotonic clock, or of the plant's own clock."""
        if not self.paced:
            return time.monotonic()
        return 1e-9 * float(self._heard.stamp) + max(0.0, time.monotonic() - self._arrived - SILENCE_MAX)

    def disarm(self, *, still: bool = False) -> None:
        """Release the lease, which disarms the plant, and wait at most 2 s; `still`: leave a reference of 0 N."""
        self._session = None
        if still:
            self._commander.publish_reference(ReferenceSignal())
            self._commander.flush()
        if unconfirmed := self._commander.release_and_wait():
            self.warn(unconfirmed)

    def listen_to_corrections(self) -> None:
        """Subscribe to the filter's corrections, and pass them to the session at each policy step."""
        if self._corrections is None:
            self._corrections = self._mailbox.subscribe(
                CORRECTION, RECORDED_TOPICS[CORRECTION][0], RECORDED_TOPICS[STATE][1]
            )

    def compensate(self, compensation: LiveCompensation) -> None:
        """Connect an online estimator: law states in, diagnostics out, a service to freeze it. Call once."""
        self.compensation = compensation

        def freeze(request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
            compensation.frozen, answer.success = bool(request.data), True
            answer.message = "the coefficients are frozen" if request.data else "the coefficients adapt again"
            self.warn(f"by {FREEZE_SERVICE}: {answer.message}")
            return answer

        def status() -> Status:
            health, frozen = compensation.health, compensation.frozen
            message = "frozen" if frozen else "adapts" if compensation.acting else "the paper's law acts"
            troubled = frozen or health["at a bound"] != "no"
            return Status(level=Level.WARN if troubled else Level.OK, message=message, values=health)

        self.create_service(SetBool, FREEZE_SERVICE, freeze)
        DiagnosticsPublisher(self, status, name="compensation")
        take = compensation.on_law_state  # each before its sample
        subscribe(self, LAW_STATE, LAW_STATE_CODEC, lambda m: take(m.sequence, m.law, m.compensated_reference))

    def destroy_node(self) -> None:
        """Leave the graph."""
        self._mailbox.close()
        super().destroy_node()

    def enable_step_publishing(self) -> None:
        """Publish a PolicyStep for each policy step on /hydro/policy from now on."""
        self._steps = create_publisher(self, POLICY)

    def listen_for_enter(self, typed: queue.SimpleQueue[str] | None = None) -> None:
        """Let Enter on the terminal arm the plant from now on; `typed`: lines of a terminal that is read already."""
        self._keys = terminal_lines() if typed is None else typed
        while not self._keys.empty():
            self._keys.get()

    def publish_gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        """See `hydro_policy.supervision.plant_supervisor.Outputs`."""
        self._commander.publish_gains(delta_kp, delta_ki, step)
        self._gains_out = time.monotonic()

    def publish_step(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None:
        """See `hydro_policy.supervision.plant_supervisor.Outputs`."""
        if self._steps is None:
            return
        message = self._step
        message.header.stamp = self._stamp()
        message.step, message.weights, message.reward = step, weights, reward
        message.mean_delta_kp, message.mean_delta_ki = mean
        self._steps.publish(message)

    def arm(self, arm: bool) -> None:
        """See `hydro_policy.supervision.plant_supervisor.Outputs`."""
        self._commander.arm(arm, self._on_arm_answer if arm else self._on_disarm_answer)

    def report(self, sentence: str, warning: bool = False) -> None:
        """See `hydro_policy.supervision.plant_supervisor.Outputs`."""
        self.announcer.report(sentence, warning)

    def warn(self, sentence: str) -> None:
        """Report a warning."""
        self.report(sentence, warning=True)

    @property
    def size(self) -> BenchScales:
        """Size of the bench that the box assumes; the nominal bench's if that is not known."""
        known = None if self.box is None else BoxIdentity.of_box(self.box).size
        return known or NOMINAL

    def _on_box(self, box: BoxDescription) -> None:
        self.box = box
        if wrong := self.box_fault(box):
            self.fail(CompanionError(wrong))
        self._end_meeting()

    def _on_box_law(self, message: BoxLawMessage) -> None:
        self.law, self._laws_told = BoxLaw.of_message(message), True
        self._end_meeting()

    def _end_meeting(self) -> None:
        if self._meeting is not None and all(requirement.ready() for requirement in self._meeting.requirements):
            self._finish()

    def _on_state(self, message: Any) -> None:
        if self._states.get_publisher_count() > 1:
            self._two_plants = True  # which of them is the plant's?
            return
        again = self._heard is not None and self._heard.sequence == message.sequence
        self._heard, self._arrived = message, time.monotonic()
        self._sampled = min(self._sampled, self._arrived)
        self._commander.deferred = self.paced
        if again and self.paced:
            self._answer()
            return
        if self._session is not None:
            self._handle(self._session, message, self._arrived)
            return
        self._unhandled.append((message, self._arrived))
        del self._unhandled[: -SAMPLES_PER_STEP if self.paced else None]
        self._end_meeting()

    def _handle(self, session: Session, message: Any, arrived: float) -> None:
        """Pass a sample to the session; the last one of a policy step behind the corrections of the step."""
        ends = message.sequence % SAMPLES_PER_STEP == 0
        try:
            if ends:
                self._read_corrections(message.sequence)
            now = 1e-9 * message.stamp if message.flags & Flag.PACED else arrived
            sends = self._commander.holds_lease and not session.finished
            if sends and session.on_sample(message.sequence, np.array(message[_SAMPLE_SLICE]), message.flags, now):
                age = seconds(self._commander.last_gains.header.stamp) - 1e-9 * message.stamp
                self.timing.add(arrived, self._gains_out, age)
            if self.paced and message.sequence % _TICK_SAMPLES == 0 and not session.finished:
                self._tick(session, self.now())
        except Exception as error:
            self.fail(error)
        if session.finished and not self._done.done():
            self.ended = message.sequence
            self._finish()
        if ends:
            self._owed = message.sequence
            self._answer()

    def _answer(self) -> None:
        """Answer the last policy step to a plant that waits for it, unless something is still to come."""
        ends = self._session is None or self._session.finished
        if (
            self._owed is None
            or not self.paced
            or ends
            or self._commander.pending_requests
            or not self._readiness.complete
        ):
            return
        self._answers.acknowledge(self._owed, self._commander.flush())
        self._owed = None

    def _stamp(self) -> Time:
        if not self.paced:
            return self.get_clock().now().to_msg()
        sec, nanosec = divmod(self._heard.stamp, 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

    def _read_corrections(self, before: float = math.inf) -> None:
        """Pass the arrived corrections to the session; on a plant's own clock those of samples up to `before` - 2.

        A correction may come after the sample that follows it, but not after the next but one.
        """
        if self._corrections is None:
            return
        fetched = self._mailbox.fetch(self._corrections, RECORDED_TOPICS[STATE][1].depth)
        self._early += [message for data, _ in fetched if (message := CORRECTION_CODEC.unpack(data)) is not None]
        if self.paced:
            count = sum(((before - 2 - message.sequence) % 2**32) < 2**31 for message in self._early)
        else:
            count = len(self._early)
        messages, self._early = self._early[:count], self._early[count:]
        for message in messages:
            self.corrected = True
            if self._session is not None:
                self._session.on_correction(message.certificate_after, message.status)

    def _on_tick(self) -> None:
        """Handle keys, companions and the session's tick; of a plant on its own clock, its samples tick the session."""
        try:
            with suppress(queue.Empty):  # a person is heard while a plant waits, too
                self._keys.get_nowait()
                if self._session is not None:
                    self._session.supervisor.arm_now(self.now())
            if not self.paced:
                self._read_corrections()
            if self._session is None and self._meeting is None:
                return
            for sentence in self.companions.poll():
                self.warn(sentence)
            if trouble := self.companions.refused or self.companions.lost:
                self.fail(CompanionError(trouble))
            elif self._meeting is not None:
                self._meeting.check(time.monotonic())
            elif self._session is not None:
                if self.paced:
                    self._readiness.check(time.monotonic())
                if not self.paced or (time.monotonic() - self._arrived > SILENCE_MAX and self._owed is None):
                    self._tick(self._session, self.now())
                self._each_tick()
                self._answer()
        except Exception as error:
            self.fail(error)

    def _tick(self, session: Session, now: float) -> None:
        self._commander.renew_lease(now)
        crowd = publisher_conflicts(self, STATE) if self._two_plants else ""
        if crowd and not self._crowd:
            self.warn(crowd)
        self._two_plants, self._crowd = False, crowd
        if self._sampled < math.inf:
            self._commander.check_timeout(now)
        if self._commander.holds_lease or self._sampled == math.inf:
            session.on_tick(now)
        if session.finished:
            self._finish()

    def _on_lease(self, lost: str) -> None:
        if lost:
            self.warn(f"the lease on the plant was lost: {lost}")
            if self._override_service is not None:
                self.destroy_service(self._override_service)
            self._override_service = None
        elif self._override_service is None:
            self._override_service = self.create_service(OverrideGains, OVERRIDE_SERVICE, self._on_override)

    def _on_override(self, request: OverrideGains.Request, answer: OverrideGains.Response) -> OverrideGains.Response:
        own, gains = self.get_name(), (request.proportional_gain, request.integral_gain)
        try:
            if request.whom not in ("", own):
                raise ValueError(f"{own} chooses the gains here, not {request.whom}")
            start = self.override.start
            told = start(*gains, request.seconds, self.now()) if request.active else self.override.release()
            answer.success, answer.message = True, told
        except (ValueError, OSError) as error:
            answer.success, answer.message = False, str(error)
            if isinstance(error, ValueError):
                self.warn(f"override refused: {error}")
            else:  # the run's record cannot be written, which ends the run
                self.fail(error)
        wanted = "hold ({:g}, {:g}) for {:g} s".format(*gains, request.seconds) if request.active else "give back"
        told = answer.message if answer.success else f"refused: {answer.message}"
        self._log_call(f"{request.name or 'somebody'}: override, {wanted}: {told}")
        return answer

    def _on_arm_answer(self, answer: Future) -> None:
        response = answer.result()
        if response is None or response.success:
            self._unarmed_since = math.inf
            return
        now = self.now()
        if response.message == DISARMED_BY_PERSON:  # for as long as the person wants
            self.warn(response.message)
            if self._session is not None:
                self._session.supervisor.defer_to_person(now)
            return
        self._unarmed_since = min(self._unarmed_since, now)
        self.warn(f"the plant was not armed: {response.message}")
        if now - self._unarmed_since > LEASE_WAIT_MAX:
            self.fail(NotReadyError(f"the plant was not armed for {LEASE_WAIT_MAX:g} s: {response.message}"))

    def _on_disarm_answer(self, answer: Future) -> None:
        response = answer.result()
        if response is not None and not response.success:
            self.warn(f"the plant did not confirm that it is disarmed: {response.message}")
