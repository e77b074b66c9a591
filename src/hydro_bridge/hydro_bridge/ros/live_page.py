# SPDX-License-Identifier: Apache-2.0
"""Live page of a run: a dashboard that starts and ends with it; its address is printed on the terminal.

HYDRO_DASHBOARD=off or --no-dashboard disables it, as in tests and CI.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import IO, cast

from rclpy.node import Node
from tqdm import tqdm

from hydro_bridge.ros.companion import Companion, CompanionError

VARIABLE = "HYDRO_DASHBOARD"
NAME = "dashboard"
_ADDRESS = "the live page: "


def page_wanted() -> bool:
    """Return whether this environment starts a page by default."""
    return os.environ.get(VARIABLE, "") != "off"


def add_page_option(parser: argparse._ActionsContainer) -> None:
    """Add --no-dashboard."""
    parser.add_argument(
        "--no-dashboard",
        dest="dashboard",
        action="store_false",
        default=page_wanted(),
        help=f"serve no live page beside the run (nor where {VARIABLE}=off)",
    )


def start_page(
    stack: ExitStack, node: Node, *, wanted: bool, keep: Callable[[str], object] = lambda line: None
) -> None:
    """Start a dashboard that `stack` ends, unless the graph already has one; call before arming.

    A page that fails to start, or ends, does not affect the run.

    Parameters
    ----------
    node
        Node of the caller.
    wanted
        False: no page.
    keep
        Takes each line of its output except its address, which contains the token and goes to the terminal only.
    """
    if not wanted or NAME in node.get_node_names():
        return
    with suppress(CompanionError):
        stack.enter_context(Companion("hydro_bridge", NAME, output=cast("IO[str]", _Output(keep))))


class _Output:
    def __init__(self, keep: Callable[[str], object]) -> None:
        self._keep = keep

    def write(self, text: str) -> int:
        """Take a line."""
        if _ADDRESS not in text:
            self._keep(text)
            return len(text)
        with suppress(OSError, ValueError):  # the terminal has gone
            tqdm.write(text.partition("] ")[2].rstrip("\n"), file=sys.stderr)
        return len(text)

    def flush(self) -> None:
        """Each line is passed on at once."""
