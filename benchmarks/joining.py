# SPDX-License-Identifier: Apache-2.0
"""What a subscriber that joins costs the one who publishes at 1 kHz: `python -m benchmarks.joining [--joins 20]`.

With shared memory Fast DDS may hold the publisher up when it first sends to another process, 333 ms of a plant's thread
(decision 0059). Subscribers join by turns: publisher and subscriber with the middleware's defaults; the publisher with
ours, and subscribers with ours, with ours but subscribing two seconds late, and as foreign tools of this machine are.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import time

import numpy as np
import rclpy
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions

from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.ros import STATE, STATE_QOS
from hydro_bridge.ros.network import PROFILES, RANGE, stay_on_this_machine
from hydro_msgs.msg import BenchState

COLUMNS = {
    "subscribers": "how they joined",
    "joins": "how many of them",
    "found": "s from its node to its first sample, median",
    "found_max": "s, the longest",
    "held_up": "joins at which one call of publish took more than 0.1 s",
    "longest": "s, the longest such call",
    "lost": "samples that a subscriber missed after its first",
}

OURS = None
"""As a node of ours has it; otherwise the discovery range of a tool that knows no profile of ours."""
CASES: dict[str, tuple[str | None, str | None, float]] = {
    "both with defaults of Fast DDS": ("LOCALHOST", "LOCALHOST", 0.0),
    "ours": (OURS, OURS, 0.0),
    "ours, subscribing 2 s late": (OURS, OURS, 2.0),
    "a tool with LOCALHOST": (OURS, "LOCALHOST", 0.0),
    "a tool with defaults (SUBNET)": (OURS, "SUBNET", 0.0),
}
"""Set-up of the publisher and of the subscriber, and s that it subscribes late."""
LISTEN = 4.5
"""s that a subscriber stays."""


def subscriber(late: float) -> None:
    """Join, hear for a while, print when the first sample came and how many were missed."""
    rclpy.init()
    node = rclpy.create_node("newcomer")
    time.sleep(late)
    heard: list[tuple[float, int]] = []
    begun = time.monotonic()
    node.create_subscription(BenchState, STATE, lambda m: heard.append((time.monotonic(), m.sequence)), STATE_QOS)
    while time.monotonic() < begun + LISTEN - late:
        rclpy.spin_once(node, timeout_sec=0.1)
    missed = int((np.diff([number for _, number in heard]) - 1).sum())
    print(json.dumps({"found": heard[0][0] - begun if heard else LISTEN, "lost": missed}), flush=True)
    os._exit(0)


def surroundings(reach: str | None) -> dict[str, str]:
    """Environment of a node of ours, or of a tool with this discovery range."""
    inherited = {name: value for name, value in os.environ.items() if name not in (PROFILES, RANGE)}
    return dict(os.environ) if reach is OURS else inherited | {RANGE: reach}


def join(message: BenchState, publisher: Publisher, late: float, reach: str | None) -> tuple[float, int, float]:
    """Publish at 1 kHz to one newcomer: s until it heard, samples it missed, s of the longest call of publish."""
    words = [sys.executable, "-m", "benchmarks.joining", "--subscriber", str(late)]
    child = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=surroundings(reach))
    longest, due = 0.0, time.monotonic()
    while child.poll() is None:
        due = max(due + 1e-3, time.monotonic())
        message.sequence += 1
        begun = time.monotonic()
        publisher.publish(message)
        longest = max(longest, time.monotonic() - begun)
        time.sleep(max(0.0, due - time.monotonic()))
    said = json.loads(child.communicate()[0])
    return said["found"], said["lost"], longest


def joins_of(count: int, name: str) -> list[tuple[float, int, float]]:
    """`join` so many times beside one publisher; in a process of its own, for Fast DDS reads its profile once."""
    publishes, subscribes, late = CASES[name]
    for variable in (PROFILES, RANGE):
        os.environ.pop(variable, None)
    if publishes is OURS:
        stay_on_this_machine()
    else:
        os.environ[RANGE] = publishes
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # the pool ends this process by a signal
    node = rclpy.create_node("publisher")
    publisher, message = node.create_publisher(BenchState, STATE, STATE_QOS), BenchState()
    joins = progress(range(count), total=count, label=name, unit="join")
    return [join(message, publisher, late, subscribes) for _ in joins]


def measure(table: Table, name: str, count: int) -> None:
    """One row."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        rows = np.array(pool.apply(joins_of, (count, name)))
    table.add(
        subscribers=name,
        joins=count,
        found=float(np.median(rows[:, 0])),
        found_max=float(rows[:, 0].max()),
        held_up=int((rows[:, 2] > 0.1).sum()),
        longest=float(rows[:, 2].max()),
        lost=int(rows[:, 1].sum()),
    )


@command()
def main() -> None:
    """Measure all cases, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.joining", description=__doc__)
    parser.add_argument("--joins", type=int, default=20, metavar="N", help="of each kind (default: %(default)s)")
    parser.add_argument("--subscriber", type=float, help=argparse.SUPPRESS)
    add_json_argument(parser)
    asked = parser.parse_args()
    if asked.subscriber is not None:
        subscriber(asked.subscriber)
    table = Table(COLUMNS, title="Subscribers that join a publisher at 1 kHz")
    for name in CASES:
        measure(table, name, asked.joins)
    table.show(asked.json)


if __name__ == "__main__":
    main()
