# SPDX-License-Identifier: Apache-2.0
"""Serves the live page of the graph that runs: look at it, disarm it; with the token, arm and override it.

ros2 run hydro_bridge dashboard                  # prints the page's address, with the token behind #
ros2 run hydro_bridge dashboard --port 8080
"""

from __future__ import annotations

import argparse
import threading
from collections.abc import Callable
from concurrent.futures import Future as Promise
from concurrent.futures import InvalidStateError
from contextlib import suppress
from functools import partial

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hydro_bridge.cli.console import command, number
from hydro_bridge.dashboard.server import ANSWER_WITHIN, PORT, PageCommand, PageServer, RefusedError, Rules, read
from hydro_bridge.dashboard.status import encoded
from hydro_bridge.nodes.dashboard_feed import Feed
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status, warn_of_duplicate_nodes
from hydro_bridge.ros.node import request_realtime, ros_arguments, run_node
from hydro_bridge.ros.topics import CLAIM_SERVICE, END_SERVICE, FREEZE_SERVICE, OVERRIDE_SERVICE
from hydro_msgs.srv import Claim, OverrideGains

_WHO = "a person, by the live page"
_NO_PLANT = "no plant runs here that could be told"
_NO_RUN = "nobody commands the plant: no run is active here"
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


HOST = "127.0.0.1"


class DashboardNode(Node):
    """Passes messages of the graph to the page, and the page's commands to the plant; publishes only its diagnostics.

    `host`, `port`: address of the page.
    """

    def __init__(self, host: str, port: int | None) -> None:
        super().__init__("dashboard")
        rules = Rules()
        self._feed = Feed(self)
        self._commands = PageCommands(self, rules, lambda: self._feed.epoch, lambda: self._feed.holder)
        self._server = PageServer(self._commands.act, host, port)
        self._feed.serve(self._server)
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        warn_of_duplicate_nodes(
            self, f"another live page runs here: both show the plant, this one at {self._server.address}"
        )
        request_realtime(realtime=False)
        print(f"the live page: {self._server.address}#token={rules.token}", flush=True)

    def close(self) -> None:
        """Disconnect the viewers."""
        self._feed.close()
        self._server.close()

    def _status(self) -> Status:
        values = {"address": self._server.address, "viewers": self._server.viewers, **self._feed.counts()}
        return Status(message=f"viewers: {self._server.viewers}", values=values)


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="dashboard", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    result.add_argument("--host", default=HOST, metavar="ADDRESS", help=f"to listen at (default {HOST}: here only)")
    result.add_argument(
        "--port", type=number(0, 65535), metavar="N", help=f"default {PORT}, if taken a free one; 0: any"
    )
    return result


@command()
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    run_node(partial(DashboardNode, options.host, options.port), ros)
