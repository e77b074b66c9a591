# SPDX-License-Identifier: Apache-2.0
"""ROS interface of every plant: the bridge's serial line and the simulation use the same node.

::

    /hydro/gains, /hydro/law, /hydro/correction, /hydro/reference ──> guard ─┐
    /hydro/claim, /hydro/arm ─────────────────────────────────────> lease    ├─ PlantInterface (line, simulation)
    /hydro/answered ─────────────────────────────────────────> lock_step ────┤
    /hydro/state, /hydro/law_state, /hydro/box, /hydro/box_law, /clock <─ publish_… ──┘

The guard receives only commands of the lease's holder (`hydro_bridge.safety.lease`), with its session's epoch, from a
single publisher. While two nodes publish one of these topics the status is ERROR, nothing can be armed, and an armed
plant is disarmed::

    /hydro/claim      take the lease, arm with it, give it back; disarming is open to any named caller
    /hydro/authority  its holder, and the epoch that commands must carry
    /hydro/arm        disarms at once for any caller; never arms

A publisher is matched with the subscription before its messages can arrive. A second publisher is therefore known by
the time of its first message; commands on a topic with two are then ignored, and an armed plant is disarmed.

A filter in the plant's process is a `Corrector`: it is called with each sample in the plant's thread, before the sample
is published. Its corrections are published like any; the plant then has no subscription to other nodes' corrections.
After an error it is called no more: the guard goes to base gains, as for any filter that is silent.

Where the plant runs by its own clock (`PlantInterface.paced`), times are the plant's, and its messages about a sample
(end of the session by a trip, /clock, state of the law) are published before the sample.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool

from hydro_bridge.ros import topics
from hydro_bridge.ros.diagnostics import (
    CALL_LOGGER,
    DiagnosticsPublisher,
    Level,
    Status,
    publisher_conflicts,
    with_publisher_conflicts,
)
from hydro_bridge.ros.messages import (
    CORRECTION_CODEC,
    LAW_STATE_CODEC,
    STATE_CODEC,
    box_to_message,
    law_command_from_message,
    law_to_message,
    pack_law_state,
    reference_from_message,
    subscribe,
)
from hydro_bridge.ros.topics import create_publisher, create_subscription
from hydro_bridge.safety.box_info import BoxDescription
from hydro_bridge.safety.plant_interface import PlantInterface
from hydro_bridge.serial.protocol import BoxLaw, LawState
from hydro_core.signals import SAMPLES_PER_STEP, Flag, Law, ReferenceSignal, flag_names
from hydro_msgs import msg
from hydro_msgs.srv import Claim


class Corrector(Protocol):
    """Contraction filter in the plant's process; see `PlantNode`."""

    def correct(self, state: Any, law: Any, epoch: int) -> Any:
        """Return the Correction record of a sample; None: there is none yet.

        `state`, `law`: records of the sample's BenchState and LawState, None: the paper's law. `epoch`: the session's.
        """

    def publish(self) -> None:
        """Publish the last correction."""


def arming_state(flags: int) -> str:
    """Return the arming state of a box: tripped, armed or disarmed."""
    return "tripped" if flags & Flag.TRIPPED else "armed" if flags & Flag.ARMED else "disarmed"


class LeaseServer:
    """Services and topic of a plant's lease: /hydro/claim, /hydro/arm, /hydro/authority; the `Lease` itself decides.

    `node`: node of the plant. `plant`: plant that is armed and disarmed. `tripped`: whether the box has disarmed by
    itself.
    """

    def __init__(self, node: Node, plant: PlantInterface, tripped: Callable[[], bool]) -> None:
        self._node, self._plant, self._tripped = node, plant, tripped
        self.lease = plant.guard.lease
        self._following = threading.Lock()
        self._armed, self._conflict = False, ""
        self.subscriptions: dict[str, Subscription] = {}
        """Subscription to the commands of each topic; commands of other topics come from this process."""
        self._publisher = create_publisher(node, topics.AUTHORITY)
        self._told: Counter[str] = Counter()
        self._corrected = False  # corrections were refused in the second before
        self._last_call = ""
        self._calls = node.get_logger().get_child(CALL_LOGGER)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tell()
        node.create_service(SetBool, topics.ARM_SERVICE, self._on_arm)
        node.create_service(Claim, topics.CLAIM_SERVICE, self._on_claim)
        node.create_timer(0.1, self._look, clock=steady)
        node.create_timer(1.0, self._tell_refused, clock=steady)

    def accepts(self, topic: str, epoch: int) -> bool:
        """Return whether a received command is the holder's; a second publisher of its topic disarms the plant."""
        if topic in self.subscriptions and self.subscriptions[topic].get_publisher_count() > 1:
            self.lease.refused[topic] += 1
            self._abort(topic)
            return False
        self.track_arming()
        return self.lease.accepts(topic, epoch, self._plant.now(), renews=topic != topics.CORRECTION)

    def conflicts(self) -> str:
        """Return a sentence about the topics with more than one publisher; empty if there is none."""
        return publisher_conflicts(self._node, *topics.COMMAND_TOPICS, topics.STATE, topics.AUTHORITY)

    def track_arming(self) -> None:
        """Track arming, and end the session on a disarm, whoever requested it, and on a trip."""
        with self._following:
            before, self._armed = self._armed, self._plant.guard.armed and not self._tripped()
            if before and not self._armed:
                self.lease.end_session(self._plant.now())
                self._tell()

    def _on_claim(self, request: Claim.Request, response: Claim.Response) -> Claim.Response:
        self.track_arming()
        lease, held = self.lease, self.lease.claim
        if request.act == Claim.Request.TAKE:
            trouble, done = lease.grant(request.name, request.claim, self._plant.now()), "taken"
        elif request.act == Claim.Request.ARM:
            trouble = lease.arm_refusal(request.claim, request.epoch, request.whom) or self.conflicts()
            if not trouble:
                trouble = self._plant.arm(True)
                if not trouble:
                    lease.on_armed()
                self.track_arming()
            done = f"armed for {lease.holder or 'nobody: base gains'}"
        elif request.act == Claim.Request.DISARM:
            trouble, done = self._disarm(request.claim), "disarmed"
        elif request.act == Claim.Request.GIVE:
            trouble = f"{lease.holder or 'nobody'} commands this plant now"
            if lease.held_by(request.claim):
                trouble = self._disarm(request.claim)
                lease.release(request.claim, self._plant.now())
            done = "disarmed, given back"
        else:
            trouble, done = f"act {request.act} is not known", ""
        if lease.claim != held:
            self._plant.lock_step.reset_commands()
            self._begin_anew(succeeds=bool(held))
            self._node.get_logger().info(f"{lease.holder or 'nobody'} commands this plant")
            self._tell()
        own = not trouble and (request.claim or request.act == Claim.Request.TAKE)
        response.success, response.message = not trouble, trouble or done
        response.claim, response.epoch = (lease.claim, lease.epoch) if own else (0, 0)
        if request.act != Claim.Request.TAKE:
            self._called(request.name or "somebody", response.message)
        return response

    def _on_arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        refusal = "nothing is armed by this service: arm by name, `ros2 run hydro_bridge arm`"
        trouble = refusal if request.data else self._disarm(0)
        response.success, response.message = not trouble, trouble or "disarmed"
        self._called("somebody, by /hydro/arm", response.message)
        return response

    def _disarm(self, claim: int) -> str:
        self.lease.on_disarmed(claim)
        trouble = self._plant.arm(False)
        self.track_arming()
        return trouble

    def _begin_anew(self, *, succeeds: bool) -> None:
        """Reset reference and law for another holder, and disarm a plant that a silent holder left armed."""
        if succeeds and self._plant.guard.armed:
            self._plant.arm(False)
        with self._plant.lock:
            self._plant.guard.set_reference(ReferenceSignal())
            self._plant.guard.release_law()
        self.track_arming()

    def _look(self) -> None:
        self.track_arming()
        before, self._conflict = self._conflict, self.conflicts()
        if before and not self._conflict:
            self._tell()  # corrects any false message about the lease
        if self._armed:
            if self._conflict:
                self._abort(topics.STATE)
        elif self.lease.expire(self._plant.now()):
            self._begin_anew(succeeds=False)
            self._node.get_logger().info("nobody commands this plant: its commander has stopped sending")
            self._tell()

    def _abort(self, topic: str) -> None:
        if not self._plant.guard.armed:
            return
        why = self.conflicts() or f"two nodes published {topic}"
        with self._plant.lock:
            self._plant.guard.abort(why)
        self._plant.send()
        self.track_arming()

    def _tell(self) -> None:
        """Publish the holder, and the epoch that commands must carry now."""
        lease = self.lease
        message = msg.Authority(holder=lease.holder, claim=lease.claim, epoch=lease.epoch)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._last_call = ""

    def _tell_refused(self) -> None:
        """Log how many commands were refused since the last call, and the publishers of these topics.

        The holder is announced again: messages of a restarted plant are ignored while its killed predecessor is still
        in the graph, and the new plant cannot know that.
        """
        news = self.lease.refused - self._told
        if news:
            self._tell()
        self._told = self.lease.refused.copy()
        corrected, self._corrected = self._corrected, news[topics.CORRECTION] > 0
        if not corrected:  # those of a filter that has not received the epoch yet
            del news[topics.CORRECTION]
        for topic, count in news.items():
            names = sorted({info.node_name for info in self._node.get_publishers_info_by_topic(topic)})
            self._node.get_logger().warning(
                f"refused: {count} of {topic} from nodes without the lease ({', '.join(names) or 'gone'}): end them"
            )

    def _called(self, who: str, answer: str) -> None:
        """Log a caller's request and the answer, once until either changes: some callers repeat their requests."""
        sentence = f"{who}: {answer}"
        if sentence != self._last_call:
            self._calls.info(sentence)
        self._last_call = sentence


class PlantNode(Node):
    """Publishes state and box, and its force law; receives gains, law, corrections, reference and arming.

    Call `connect` once the plant exists; nothing is subscribed before.

    `name`: name of the node. `corrector`: filter in this process; None: corrections come from /hydro/correction.
    """

    def __init__(self, name: str, corrector: Corrector | None = None) -> None:
        super().__init__(name)
        self._corrector = corrector
        self.done: Future = Future()
        """Future that gets the exception if the plant's thread fails."""
        self._defect = ""  # of a filter in this process
        self.components = [] if corrector is None else [corrector]
        self._publisher = create_publisher(self, topics.STATE)
        self._law_publisher = create_publisher(self, topics.LAW_STATE)
        self._box_publisher = create_publisher(self, topics.BOX)
        self._box_law_publisher = create_publisher(self, topics.BOX_LAW)
        self._clock_publisher = create_publisher(self, topics.CLOCK)
        self._clock_message = ClockMessage()
        self._peers: set[str] = set()  # in the graph at the last poll
        self._flags, self._tripped = 0, False
        self._beside_another = False

    def connect(self, plant: PlantInterface) -> None:
        """Accept commands for `plant`, and report its status."""
        self.plant = plant
        limits = plant.guard.settings
        only = "" if limits.relies_on == "nothing" else f"; the bench bears them behind this filter: {limits.relies_on}"
        self.get_logger().info(
            f"the guard passes delta_kp from {limits.delta_kp_min:g} to {limits.delta_kp_max:g} 1/s and delta_ki from "
            f"{limits.delta_ki_min:g} to {limits.delta_ki_max:g} 1/s^2{only}"
        )
        if not limits.require_filter:
            self.get_logger().warning(
                "guard.require_filter is false: gains reach the valve UNFILTERED and may make the loop unstable"
            )
        self._thread = threading.Thread(target=self._run, name="plant", daemon=True)
        self.lease_server = LeaseServer(self, plant, lambda: bool(self._flags & Flag.TRIPPED))
        subscriptions = self.lease_server.subscriptions  # no callback runs before the node is spun
        if self._corrector is None:
            subscriptions[topics.CORRECTION] = subscribe(self, topics.CORRECTION, CORRECTION_CODEC, self._on_correction)
        for topic in (topics.GAINS, topics.REFERENCE, topics.LAW):
            subscriptions[topic] = create_subscription(self, topic, partial(self._on_command, topic))
        self._answers = create_subscription(self, topics.ANSWERED, self._on_answered)
        self.create_timer(0.1, self._tell_events, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_timer(1.0, self._look_for_peers, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.diagnostics = DiagnosticsPublisher(self, self._status)

    def begin(self) -> None:
        """Start the plant's thread; call only once all settings are checked."""
        self._thread.start()

    def _run(self) -> None:
        """Run the plant; an error ends the node, which disarms on its way."""
        try:
            self.plant.run()
        except Exception as error:
            self.done.set_exception(error)

    def close(self) -> None:
        """Disarm, and end the plant's thread."""
        self.plant.stop()  # first: `lock_step` may release one more sample, depending on the timing of threads
        self.plant.lock_step.close()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def correct(self, stamp_ns: int, sequence: int, values: Sequence[float], flags: int, law: LawState | None) -> None:
        """Correct a sample by the filter in this process, if there is one, before the sample is published."""
        if self._corrector is None:
            return
        state, acting = STATE_CODEC.record(stamp_ns, sequence, *values, flags), None
        if law is not None and law.law is not Law.PAPER:
            acting = LAW_STATE_CODEC.unpack(pack_law_state(stamp_ns, sequence, law))
        try:
            correction = self._corrector.correct(state, acting, self.lease_server.lease.epoch)
        except Exception as error:
            self._corrector = None
            self._defect = f"the filter failed, start this plant anew: {type(error).__name__}: {error}"
            self.get_logger().fatal(f"nothing is corrected: {self._defect}")
            return
        if correction is not None:
            self._on_correction(correction)

    def publish_sample(
        self, stamp_ns: int, sequence: int, values: Sequence[float], flags: int, law: LawState | None
    ) -> None:
        """Publish one sample, after the state of its law unless that is the paper's, and before its correction.

        Call from the plant's thread only. `values`: in STATE_FIELDS order.
        """
        changed, self._flags = flags ^ self._flags, flags
        if not self.plant.real_time:
            if changed & (Flag.ARMED | Flag.TRIPPED):
                self.lease_server.track_arming()
            if sequence % SAMPLES_PER_STEP == 0:
                self._clock_message.clock.sec, self._clock_message.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
                self._clock_publisher.publish(self._clock_message)
        if law is not None and law.law is not Law.PAPER:
            self._law_publisher.publish(pack_law_state(stamp_ns, sequence, law))
        self._publisher.publish(STATE_CODEC.pack(stamp_ns, sequence, *values, flags))
        if self._corrector is not None:
            self._corrector.publish()

    def publish_box(self, box: BoxDescription, law: BoxLaw | None) -> None:
        """Publish the box's description and its compensated law, None if it has none, and set that law in the guard.

        Call at the start, and whenever another box may be connected.
        """
        with self.plant.lock:
            self.plant.guard.set_box_law(law)
        now = self.get_clock().now().to_msg()
        self._box_law_publisher.publish(law_to_message(law, now))
        self._box_publisher.publish(box_to_message(box, now))

    def _on_command(self, topic: str, message: Any) -> None:
        """Set gains, law or reference in the guard, from a message with the epoch of the session."""
        if self.lease_server.accepts(topic, message.epoch):
            law = law_command_from_message(message) if topic == topics.LAW else None
            signal = reference_from_message(message) if topic == topics.REFERENCE else None
            with self.plant.lock:
                if topic == topics.GAINS:
                    self.plant.guard.set_gains(message.delta_kp, message.delta_ki, self.plant.now())
                elif law is not None:
                    self.plant.guard.set_law(law, self.plant.now())
                elif signal is not None:
                    self.plant.guard.set_reference(signal)
            if topic == topics.LAW and law is None:
                self.get_logger().warning(f"unknown force law {message.law}: refused", throttle_duration_sec=5.0)
            if topic == topics.REFERENCE and signal is None:
                waveform = f"unknown waveform {message.waveform}"
                self.get_logger().warning(f"reference refused, the last one is kept: {waveform}")
        self.plant.lock_step.on_command()

    def _on_correction(self, message: Any) -> None:
        if self.lease_server.accepts(topics.CORRECTION, message.epoch):
            with self.plant.lock:
                self.plant.guard.set_correction(message.delta_u, message.status, message.sequence, self.plant.now())
            self.plant.send(message.sequence)
        if not self.plant.real_time:
            self.plant.lock_step.on_correction(message.sequence)

    def _on_answered(self, message: msg.Answered) -> None:
        sequence = message.sequence if message.answers else None
        self.plant.lock_step.on_answer(message.node, sequence, message.window, message.commands)

    def _look_for_peers(self) -> None:
        """Remove peers missing from the graph in two successive polls: a new one may not have its name there yet."""
        before, now = self._peers, self.get_publishers_info_by_topic(topics.ANSWERED)
        self._peers = {info.node_name for info in now}
        self.plant.lock_step.retain_peers(before | self._peers)

    def _status(self) -> Status:
        plant, status = self.plant, self.plant.status()
        with plant.lock:
            guard, aborted = asdict(plant.guard.counts), plant.guard.abort_reason
        required = plant.guard.settings.require_filter
        message = status.message + ("" if required else ", FILTER NOT REQUIRED") + (f": {aborted}" if aborted else "")
        trouble = plant.flags & (Flag.TRIPPED | Flag.SENSOR_FAULT | Flag.FORCE_LIMIT | Flag.WATCHDOG)
        least = Level.WARN if aborted or not required or trouble else Level.OK
        values = {"flags": flag_names(plant.flags), "require filter": required, **status.values}
        values |= {f"guard {name}": count for name, count in guard.items()}
        lease = self.lease_server.lease
        values |= {"authority": lease.holder or "nobody"}
        values |= {f"refused {topic}": lease.refused[topic] for topic in topics.COMMAND_TOPICS}
        if self._defect:
            least, message = Level.ERROR, f"{message}, NOTHING IS CORRECTED: {self._defect}"
        status = Status(level=max(status.level, least), message=message, values=values)
        before, self._beside_another = self._beside_another, self.count_publishers(topics.STATE) > 1
        if self._beside_another and not before:
            self.get_logger().error("two plants publish /hydro/state, so nothing can be armed: stop one of them")
        return with_publisher_conflicts(status, self.lease_server.conflicts())

    def _tell_events(self) -> None:
        with self.plant.lock:
            events = self.plant.guard.take_events()
        for event, trouble in events.items():
            if trouble:
                self.get_logger().warning(event)
            else:
                self.get_logger().info(event)
        flags, before, self._tripped = self._flags, self._tripped, bool(self._flags & Flag.TRIPPED)
        if self._tripped and not before:
            self.get_logger().warning(f"the box tripped ({flag_names(flags)}): find the cause, disarm it, then arm it")
