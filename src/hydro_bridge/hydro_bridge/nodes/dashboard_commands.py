# SPDX-License-Identifier: Apache-2.0
"""Execution of a page's commands through the public services /hydro/claim, /hydro/override and others."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future as Promise
from concurrent.futures import InvalidStateError
from contextlib import suppress

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hydro_bridge.dashboard.commands import PageCommand, RefusedError, Rules, read
from hydro_bridge.dashboard.server import ANSWER_WITHIN
from hydro_bridge.dashboard.words import encoded
from hydro_bridge.ros.topics import CLAIM_SERVICE, END_SERVICE, FREEZE_SERVICE, OVERRIDE_SERVICE
from hydro_msgs.srv import Claim, OverrideGains

_WHO = "a person, by the live page"
_NO_PLANT = "no plant runs here that could be told"
_NO_RUN = "nobody commands the plant: there is no run here"
_NO_ESTIMATOR = "no run here fits the coefficients of the compensated law"


class PageCommands:
    """Calls the services and returns their answers to the page.

    Parameters
    ----------
    node
        Calls the services on the page's behalf.
    rules
        Decides which commands are accepted.
    epoch
        Returns the plant's present epoch; 0: none.
    holder
        Returns the holder of the authority, for whom a page's override is meant.
    """

    def __init__(self, node: Node, rules: Rules, epoch: Callable[[], int], holder: Callable[[], str]) -> None:
        self._node, self._rules, self._epoch, self._holder = node, rules, epoch, holder
        self._claim = node.create_client(Claim, CLAIM_SERVICE)
        self._override = node.create_client(OverrideGains, OVERRIDE_SERVICE)
        self._end = node.create_client(Trigger, END_SERVICE)
        self._freeze = node.create_client(SetBool, FREEZE_SERVICE)

    def act(self, text: str | bytes) -> Promise[str]:
        """Execute a received command in the caller's thread; the answer for the page follows later."""
        told: Promise[str] = Promise()
        command = PageCommand(command="")
        try:
            command = read(text)
            self._rules.check(command, self._epoch())
            client, request, absent = self._asked(command)
            if not client.service_is_ready():
                raise RefusedError(absent)
        except RefusedError as refused:
            told.set_result(_answer(command, False, str(refused)))
            return told
        answer = client.call_async(request)
        late = threading.Timer(ANSWER_WITHIN, self._give_up, (client, answer, command, told))
        late.daemon = True
        late.start()
        answer.add_done_callback(lambda done: self._tell(done, command, told, late))
        if command.command != "disarm":
            self._node.get_logger().info(f"the page asks: {command.command}")
        return told

    def _asked(self, command: PageCommand) -> tuple[Client, object, str]:
        if command.command == "disarm":
            return self._claim, Claim.Request(act=Claim.Request.DISARM, name=_WHO), _NO_PLANT
        if command.command == "arm":
            request = Claim.Request(act=Claim.Request.ARM, name=_WHO, epoch=int(command.epoch))
            return self._claim, request, _NO_PLANT
        if command.command == "end":
            return self._end, Trigger.Request(), _NO_RUN
        if command.command in ("freeze", "adapt"):
            return self._freeze, SetBool.Request(data=command.command == "freeze"), _NO_ESTIMATOR
        if command.command == "release":
            return self._override, OverrideGains.Request(active=False, name=_WHO, whom=self._holder()), _NO_RUN
        gains = OverrideGains.Request(
            active=True,
            name=_WHO,
            proportional_gain=command.kp,
            integral_gain=command.ki,
            seconds=command.seconds,
            whom=self._holder(),
        )
        return self._override, gains, _NO_RUN

    def _tell(self, answer: Future, command: PageCommand, told: Promise[str], late: threading.Timer) -> None:
        late.cancel()
        response = None if answer.exception() else answer.result()
        if response is not None:
            _settle(told, _answer(command, response.success, response.message))

    def _give_up(self, client: Client, answer: Future, command: PageCommand, told: Promise[str]) -> None:
        client.remove_pending_request(answer)
        _settle(told, _answer(command, False, f"no answer within {ANSWER_WITHIN:g} s"))


def _settle(told: Promise[str], answer: str) -> None:
    """Set the first answer only: the plant's and the time-out's arrive in two threads."""
    with suppress(InvalidStateError):
        told.set_result(answer)


def _answer(command: PageCommand, success: bool, message: str) -> str:
    content = {"number": command.number, "command": command.command, "success": success, "text": message}
    return encoded("answer", content)
