# SPDX-License-Identifier: Apache-2.0
"""Serves the live page of the graph that runs: look at it, disarm it; with the token, arm and override it.

ros2 run hydro_bridge dashboard                  # prints the page's address, with the token behind #
ros2 run hydro_bridge dashboard --port 8080
"""

from __future__ import annotations

import argparse
from functools import partial

from rclpy.node import Node

from hydro_bridge.cli.console import command
from hydro_bridge.dashboard.commands import Rules
from hydro_bridge.dashboard.server import PORT, PageServer
from hydro_bridge.nodes.dashboard_commands import PageCommands
from hydro_bridge.nodes.dashboard_feed import Feed
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status, warn_of_duplicate_nodes
from hydro_bridge.ros.node import request_realtime, ros_arguments, run_node

HOST = "127.0.0.1"


class DashboardNode(Node):
    """Passes messages of the graph to the page, and the page's commands to the plant; publishes only its diagnostics.

    Parameters
    ----------
    host, port
        Address of the page.
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


def _port(text: str) -> int:
    if text.isascii() and text.isdecimal() and int(text) < 2**16:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text}: a port is a number from 0 (any free one) to 65535")


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="dashboard", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    result.add_argument("--host", default=HOST, metavar="ADDRESS", help=f"to listen at (default {HOST}: here only)")
    result.add_argument(
        "--port", type=_port, metavar="N", help=f"default {PORT}, or any free one where that is taken; 0: any"
    )
    return result


@command()
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    options = parser().parse_args(own)
    run_node(partial(DashboardNode, options.host, options.port), ros)
