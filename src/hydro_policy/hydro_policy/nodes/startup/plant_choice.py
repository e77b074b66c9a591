# SPDX-License-Identifier: Apache-2.0
"""Choice of the plant if none is named: the running one or, after asking, the simulation.

Without a terminal nobody can be asked; the program then ends with one sentence instead of waiting forever.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from rclpy.node import Node

from hydro_bridge.errors import UserError
from hydro_bridge.ros.topics import STATE

LOOK = 5.0
"""s of search for a running plant before a person is asked; discovery takes half a second."""

WAIT = 20.0
"""s of search without a terminal: a plant started by the same script takes time."""

NONE = "no plant runs: nobody publishes /hydro/state"


def choose_plant(node: Node, ask: Callable[[str], str] | None = None) -> str:
    """Return `external` if a plant runs, or `sim` if a person wants the simulation.

    Parameters
    ----------
    node
        Looks for the publisher of /hydro/state.
    ask
        Takes the question and returns the answer; by default `input` on a terminal, and nothing without one.

    Raises
    ------
    UserError
        No plant runs, and the simulation is not wanted.
    """
    if ask is None and sys.stdin is not None and sys.stdin.isatty():
        ask = input
    end = time.monotonic() + (LOOK if ask else WAIT)
    while not node.count_publishers(STATE):
        if time.monotonic() > end:
            return _simulation(ask)
        time.sleep(0.05)
    return "external"


def _simulation(ask: Callable[[str], str] | None) -> str:
    if ask is not None:
        try:
            answer = ask(f"{NONE}. Start the simulation, as --plant sim does? [Y/n] ")
        except EOFError:
            answer = "no"
        if answer.strip().lower() in ("", "y", "yes"):
            return "sim"
    raise UserError(f"{NONE}; start one, or name what to start: --plant sim, emulator or bench")
