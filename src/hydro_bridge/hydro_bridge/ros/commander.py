# SPDX-License-Identifier: Apache-2.0
"""Command of a plant: a node requests the lease, renews it, and publishes gains, law and references under it.

Without the lease nothing is published, and not even a publisher exists.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.task import Future
from std_srvs.srv import Trigger

from hydro_bridge.ros import topics
from hydro_bridge.ros.messages import reference_to_message
from hydro_bridge.ros.node import node_executor
from hydro_bridge.ros.topics import create_publisher, create_subscription
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.signals import LawCommand, ReferenceSignal
from hydro_msgs import msg
from hydro_msgs.srv import Claim

LEASE_WAIT_MAX = 600.0
"""Longest wait [s] for the lease while another node holds it."""
LEASE_ANSWER_TIMEOUT = 30.0
"""Longest wait [s] for a plant that does not report on its lease."""


class Commander:
    """A node's lease on the running plant. Use it only in the thread that spins the node.

    Under the plant's clock (`deferred`) commands are published by `flush`, at the end of the node's answer to a sample:
    the last gains, law and reference go out together, and the number of commands is part of the answer.

    Parameters
    ----------
    node
        The commanding node, whose name is the holder's.
    on_lease_change
        Called when the lease has been granted (with an empty sentence) or lost (with the reason).
    end
        Ends the run, as Ctrl-C does; open to all callers of /hydro/end while this node commands. None: no such service.
    warn
        Logs the reason why the node waits for the lease.
    lease_wait_max
        Longest wait [s] while another node holds the lease.
    """

    def __init__(
        self,
        node: Node,
        on_lease_change: Callable[[str], None] = lambda why: None,
        end: Callable[[], None] | None = None,
        warn: Callable[[str], None] = lambda sentence: None,
        lease_wait_max: float = LEASE_WAIT_MAX,
    ) -> None:
        self._node, self._on_lease_change, self._end, self._warn = node, on_lease_change, end, warn
        self._lease_wait_max = lease_wait_max
        self._end_service: Service | None = None
        self._claims = node.create_client(Claim, topics.CLAIM_SERVICE)
        self._said = msg.Authority()  # the plant's last message about the lease
        self._claim = self._known = 0  # the second: the epoch at the last request
        self.epoch = 0
        """Epoch of the session if this node commands the plant, else 0."""
        self._refusal, self._told = "", ""  # in the plant's last answer, empty: granted or none; last warning
        self._waits_since = inf
        self._answer: Future | None = None
        self._asked = -inf
        self.deferred = False
        """Whether commands wait for `flush`."""
        self.pending_requests = 0
        """Number of requests that the plant has not answered yet."""
        self.on_answer: Callable[[], None] = lambda: None
        """Called once an answer of the plant has been processed."""
        self.stamp: Callable[[], Time] = lambda: node.get_clock().now().to_msg()
        """Returns the stamp of the next message."""
        self._collected: dict[str, Any] = {}  # messages by topic
        self._sent = 0  # commands under the present claim
        self._reference: ReferenceSignal | None = None
        self.last_gains = msg.Gains()
        """Last published gains, with their stamp."""
        self._law = msg.LawCommand()
        self._publishers: dict[str, Publisher] = {}  # that of a law from its first command on
        self._words = create_subscription(node, topics.AUTHORITY, self._on_authority)

    @property
    def holds_lease(self) -> bool:
        """Whether this node commands the plant."""
        return bool(self._claim)

    def renew_lease(self, now: float) -> None:
        """Take or renew the lease; call several times a second, `now` by the monotonic clock or the plant's own [s]."""
        since = now - self._asked  # negative once the plant's clock has taken over
        waiting = self._answer is not None and not self._answer.done() and 0.0 <= since < 3.0  # it may have ended
        if waiting or 0.0 <= since < 0.5 or not self._claims.service_is_ready():
            return
        self._asked, self._known = now, self.epoch
        self._answer = self._ask(Claim.Request.TAKE, callback=self._on_taken)

    def check_timeout(self, now: float) -> None:
        """Warn once of each reason why this node lacks the lease on a present plant; call as often as `renew_lease`.

        Raises NotReadyError: the plant is silent for `LEASE_ANSWER_TIMEOUT`, or another node holds it for
        `lease_wait_max`.
        """
        if self.holds_lease:
            self._waits_since, self._told = inf, ""
            return
        self._waits_since = min(self._waits_since, now)
        within = self._lease_wait_max if self._refusal else LEASE_ANSWER_TIMEOUT
        if self._refusal and self._refusal != self._told:
            self._warn(f"{self._refusal}; {self._node.get_name()} waits, {within:g} s at most")
        self._told = self._refusal
        if now - self._waits_since > within:
            why = self._refusal or "the plant does not say who may command it (/hydro/claim)"
            raise NotReadyError(f"{why}, still after {within:g} s")

    def publish_gains(self, delta_kp: float, delta_ki: float, step: int = 0) -> None:
        """Publish gain changes [1/s], [1/s^2] if this node holds the lease."""
        message = self.last_gains
        message.delta_kp, message.delta_ki = delta_kp, delta_ki
        self._send(topics.GAINS, message, step)

    def publish_law(self, command: LawCommand, step: int = 0) -> None:
        """Publish the command of a force law if this node holds the lease; without one, the paper's law runs."""
        if self.holds_lease and topics.LAW not in self._publishers:
            self._publishers[topics.LAW] = create_publisher(self._node, topics.LAW)
        message = self._law
        message.law = int(command.law)
        message.a_0, message.a_1, message.a_2, message.a_3, message.a_4 = command.coefficients
        message.velocity_compensation = command.velocity_compensation
        message.valve_gain_scale = command.valve_gain_scale
        self._send(topics.LAW, message, step)

    def publish_reference(self, signal: ReferenceSignal) -> None:
        """Publish the reference; without the lease, as soon as it is granted."""
        self._reference = signal
        self._send(topics.REFERENCE, reference_to_message(signal, self.epoch))

    def _send(self, topic: str, message: Any, step: int | None = None) -> None:
        if step is not None:
            message.header.stamp, message.step, message.epoch = self.stamp(), step, self.epoch
        if topic not in self._publishers:
            return
        if self.deferred:
            self._collected[topic] = message
        else:
            self._publishers[topic].publish(message)

    def flush(self) -> int:
        """Publish the collected commands; returns the number of commands under the present claim."""
        collected, self._collected = self._collected, {}
        for topic, message in collected.items():
            if topic in self._publishers:
                message.epoch = self.epoch
                self._publishers[topic].publish(message)
                self._sent += 1
        return self._sent

    def arm(self, arm: bool, callback: Callable[[Future], None] = lambda answer: None) -> Future | None:
        """Request arming or disarming if this node holds the lease and the plant is present; return the plant's answer.

        `callback`: called with the answer on its arrival.
        """
        if not (self.holds_lease and self._claims.service_is_ready()):
            return None
        return self._ask(Claim.Request.ARM if arm else Claim.Request.DISARM, callback=callback)

    def release(self) -> Future | None:
        """Release the lease, which disarms; return the plant's answer, or None without the lease."""
        if not (self.holds_lease and self._claims.service_is_ready()):
            return None
        self._collected = {}  # of a session that has ended
        answer = self._ask(Claim.Request.GIVE)
        self._lose("")
        return answer

    def release_and_wait(self) -> str:
        """Release the lease, and spin the node until the answer; return a warning unless disarming is confirmed."""
        if not self.holds_lease:
            return ""
        answer = self.release()
        if answer is not None:
            node_executor(self._node).spin_until_future_complete(answer, timeout_sec=2.0)
        if answer is not None and answer.done() and answer.result().success:
            return ""
        return "the plant did not confirm that it is disarmed: to be sure, `ros2 run hydro_bridge arm --off`"

    def _ask(self, act: int, *, callback: Callable[[Future], None] = lambda answer: None) -> Future:
        self.flush()  # commands decided earlier go out first

        def answered(answer: Future) -> None:
            self.pending_requests -= 1
            callback(answer)
            self.on_answer()

        request = Claim.Request(act=act, name=self._node.get_name(), claim=self._claim)
        answer = self._claims.call_async(request)
        self.pending_requests += 1
        answer.add_done_callback(answered)
        return answer

    def _on_taken(self, answer: Future) -> None:
        response = answer.result()
        if response is None or answer is not self._answer:
            return
        self._refusal = "" if response.success else response.message
        if not response.success:
            if self.holds_lease:
                self._lose(response.message)
        elif response.claim != self._claim:
            self._claim, self.epoch, self._sent = response.claim, response.epoch, 0
            self._on_authority(self._said)  # the message about this claim may arrive before its answer
            first = not self._publishers
            if first:
                for topic in (topics.GAINS, topics.REFERENCE):
                    self._publishers[topic] = create_publisher(self._node, topic)
            if self._reference is not None:
                self.publish_reference(self._reference)
            if first and self._end is not None:
                self._end_service = self._node.create_service(Trigger, topics.END_SERVICE, self._on_end)
            if first:
                self._on_lease_change("")
        elif self.epoch == self._known:  # no other holder was announced meanwhile; a message may have been lost
            self.epoch = response.epoch

    def _lose(self, why: str) -> None:
        self._claim = self.epoch = self._sent = 0
        self._collected = {}
        self._answer = self._reference = None
        for topic, publisher in self._publishers.items():
            if topic == topics.REFERENCE:
                with suppress(RuntimeError):  # not every middleware supports it
                    publisher.wait_for_all_acked(Duration(seconds=0.1))  # else the last reference is lost
            self._node.destroy_publisher(publisher)
        self._publishers = {}
        if self._end_service is not None:
            self._node.destroy_service(self._end_service)
        self._end_service = None
        if why:
            self._on_lease_change(why)

    def _on_end(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        assert self._end is not None
        self._end()
        answer.success, answer.message = True, f"{self._node.get_name()} ends: it disarms, and keeps what it has"
        return answer

    def _on_authority(self, message: msg.Authority) -> None:
        if self._words.get_publisher_count() > 1:
            return  # the plant repeats it once it is alone
        self._said = message
        if self._claim and message.claim == self._claim:
            self.epoch = message.epoch
