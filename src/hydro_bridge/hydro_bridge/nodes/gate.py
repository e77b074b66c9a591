# SPDX-License-Identifier: Apache-2.0
"""Filters the commands that reach a plant: only the authority's, with its session's epoch, from a single publisher.

::

    /hydro/claim      take the authority, arm with it, give it back; disarm, for anybody, by name
    /hydro/authority  who has it, and the epoch that commands must carry
    /hydro/arm        disarms for anybody, at once; arms for nobody

Before a message can come its publisher is matched with the subscription: so a second publisher is known by the time its
first message is here, and a topic with two is believed no more. What was armed is then disarmed.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool

from hydro_bridge.nodes.gate_words import GateWords
from hydro_bridge.ros import (
    ARM_SERVICE,
    AUTHORITY,
    CLAIM_SERVICE,
    COMMANDS,
    CORRECTION,
    STATE,
    publisher_conflicts,
)
from hydro_bridge.safety.authority import Authority
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.signals import ReferenceSignal
from hydro_msgs.srv import Claim

BY_NAME = "nothing is armed by this service: arm by name, `ros2 run hydro_bridge arm`"
_LOOK = 0.1  # s, between two looks at who publishes


class Plant(Protocol):
    """What is armed; see `hydro_bridge.nodes.plant_node.PlantSide`."""

    guard: CommandGuard

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """Held while the guard is told or asked."""

    def send(self, corrects: int | None = None) -> None:
        """A new command may go down now."""

    def arm(self, arm: bool) -> str:
        """Arm or disarm; why it did not work, or nothing."""


class Gate:
    """The authority over one plant, on the graph.

    Parameters
    ----------
    node
        The plant's.
    plant
        What is armed and disarmed.
    tripped
        Whether the box has disarmed by itself.
    """

    def __init__(self, node: Node, plant: Plant, tripped: Callable[[], bool]) -> None:
        self.authority = Authority()
        self._node, self._plant, self._tripped = node, plant, tripped
        self._armed, self._crowd = False, ""
        self._heard: dict[str, Subscription] = {}
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._words = GateWords(node, self.authority)
        self._words.tell()
        node.create_service(SetBool, ARM_SERVICE, self._on_arm)
        node.create_service(Claim, CLAIM_SERVICE, self._on_claim)
        node.create_timer(_LOOK, self._look, clock=self._clock)
        node.create_timer(1.0, self._words.tell_refused, clock=self._clock)

    def listen(self, topic: str, subscription: Subscription) -> None:
        """`subscription` is where commands of `topic` come from."""
        self._heard[topic] = subscription

    def admits(self, topic: str, epoch: int) -> bool:
        """Whether a command that has just come is to be taken; a second publisher of its topic ends the session."""
        if self._heard[topic].get_publisher_count() > 1:
            self.authority.refused[topic] += 1
            self._give_up(topic)
            return False
        self._follow()
        now = self._now()
        admitted = self.authority.admits(topic, epoch, now)
        if admitted and topic != CORRECTION:  # the filter goes on without the holder
            self.authority.hear(now)
        return admitted

    def crowd(self) -> str:
        """Which topics have more than one publisher, in a sentence; empty if none has."""
        return publisher_conflicts(self._node, *COMMANDS, STATE, AUTHORITY)

    def values(self) -> dict[str, object]:
        """For /diagnostics."""
        refused = {f"refused {topic}": self.authority.refused[topic] for topic in COMMANDS}
        return {"authority": self.authority.holder or "nobody", **refused}

    def _on_claim(self, request: Claim.Request, response: Claim.Response) -> Claim.Response:
        self._follow()
        held = self.authority.claim
        if request.act == Claim.Request.TAKE:
            trouble = self.authority.take(request.name, request.claim, self._now())
            done = "taken"
        elif request.act == Claim.Request.ARM:
            trouble, done = (
                self._arm(request.claim, request.epoch, request.whom),
                f"armed for {self.authority.holder or 'nobody: base gains'}",
            )
        elif request.act == Claim.Request.DISARM:
            trouble, done = self._disarm(), "disarmed"
        elif request.act == Claim.Request.GIVE:
            trouble = self._take_back(request.claim, request.whom)
            done = f"disarmed, handed over to {request.whom}" if request.whom else "disarmed, given back"
        else:
            trouble, done = f"act {request.act} is not known", ""
        if self.authority.claim != held:
            self._begin_anew(succeeds=bool(held))
            self._words.say(f"{self.authority.holder or 'nobody'} commands this plant")
            self._words.tell()
        own = not trouble and (request.claim or request.act == Claim.Request.TAKE)
        response.success, response.message = not trouble, trouble or done
        response.claim, response.epoch = (self.authority.claim, self.authority.epoch) if own else (0, 0)
        if request.act != Claim.Request.TAKE:
            self._words.called(request.name or "somebody", response.message)
        return response

    def _on_arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        trouble = BY_NAME if request.data else self._disarm()
        response.success, response.message = not trouble, trouble or "disarmed"
        self._words.called("somebody, by /hydro/arm", response.message)
        return response

    def _disarm(self) -> str:
        trouble = self._plant.arm(False)
        self._follow()
        return trouble

    def _arm(self, claim: int, epoch: int, whom: str) -> str:
        if whom and whom != self.authority.holder:
            return f"{self.authority.holder or 'nobody'} commands this plant, not {whom}"
        if claim not in (0, self.authority.claim):
            return f"{self.authority.holder or 'nobody'} commands this plant now"
        if epoch not in (0, self.authority.epoch):
            return "the plant was disarmed, tripped or changed hands since: look, and ask again"
        trouble = self.crowd() or self._plant.arm(True)
        self._follow()
        return trouble

    def _take_back(self, claim: int, heir: str) -> str:
        if not claim or claim != self.authority.claim:
            return f"{self.authority.holder or 'nobody'} commands this plant now"
        trouble = self._disarm()
        self.authority.give(claim, self._now(), heir)
        return trouble

    def _begin_anew(self, *, succeeds: bool) -> None:
        """Nobody inherits a reference, nor, from a holder that has fallen silent, an armed plant."""
        if succeeds and self._plant.guard.armed:
            self._plant.arm(False)
        with self._plant.lock:
            self._plant.guard.set_reference(ReferenceSignal())
        self._follow()

    def _look(self) -> None:
        self._follow()
        before, self._crowd = self._crowd, self.crowd()
        if before and not self._crowd:
            self._words.tell()  # whoever heard a false word on the authority hears the true one again
        if self._armed:
            if self._crowd:
                self._give_up(STATE)
        elif self.authority.lapse(self._now()):
            self._begin_anew(succeeds=False)
            self._words.say("nobody commands this plant: who did has fallen silent")
            self._words.tell()

    def _follow(self) -> None:
        """The session ends with a disarm, whoever asked for it, and with a trip."""
        before, self._armed = self._armed, self._plant.guard.armed and not self._tripped()
        if before and not self._armed:
            self.authority.end(self._now())
            self._words.tell()

    def _give_up(self, topic: str) -> None:
        if not self._plant.guard.armed:
            return
        why = self.crowd() or f"two nodes published {topic}"
        with self._plant.lock:
            self._plant.guard.give_up(why)
        self._plant.send()
        self._follow()

    def _now(self) -> float:
        return 1e-9 * float(self._clock.now().nanoseconds)
