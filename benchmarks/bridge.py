# SPDX-License-Identifier: Apache-2.0
"""What the bridge's parts cost per sample: frames, guard, clock, publishing; and how fast recordings come and go."""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import rclpy

from hydro_bridge.bags.recording import BagWriter, read_bag, stream_bag
from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_bridge.link.clock import BoxClock
from hydro_bridge.ros.messages import StateMessage
from hydro_bridge.ros.topics import GRAPH, STATE
from hydro_bridge.safety.guard import CommandGuard
from hydro_bridge.serial.protocol import encode_command, encode_state
from hydro_bridge.serial.stream import Decoder, SequenceTracker
from hydro_bridge.signals import STATE_DTYPE, STATE_FIELDS, Command, CorrectionStatus

CALLS = 50_000
PIECE = 100_000


def cost(work: Callable[[], object]) -> float:
    """Processor time of one call [us], the best of five rounds."""
    rounds = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(CALLS // 5):
            work()
        rounds.append((time.process_time() - began) / (CALLS // 5))
    return 1e6 * min(rounds)


def costs() -> dict[str, float]:
    """Processor time [us] of each step that a sample takes."""
    values = [float(n) for n in range(len(STATE_FIELDS))]
    state, command = encode_state(5, 10**9, values, 3, 4), encode_command(1, 2, Command(arm=True))
    decoder, tracker, clock, guard, message = Decoder(), SequenceTracker(), BoxClock(), CommandGuard(), StateMessage()
    guard.set_gains(30.0, 4.0, 0.0)
    guard.set_correction(0.01, CorrectionStatus.PASS, 1, 0.0)
    numbers, ticks = count(), count(0, 1000)

    def stamp() -> None:
        tick = next(ticks)
        clock.stamp(tick, 1000 * tick + 12_345)

    rclpy.init()
    node = rclpy.create_node("benchmark")
    kind, qos = GRAPH[STATE]
    publisher = node.create_publisher(kind, STATE, qos)
    done = {
        "encode a state frame": cost(lambda: encode_state(5, 10**9, values, 3, 4)),
        "decode a state frame": cost(lambda: decoder.feed(state)),
        "encode a command frame": cost(lambda: encode_command(1, 2, Command(arm=True))),
        "decode a command frame": cost(lambda: decoder.feed(command)),
        "check a sequence number": cost(lambda: tracker.accept(next(numbers))),
        "map the box's time": cost(stamp),
        "put a command together (guard)": cost(lambda: guard.command(0.01)),
        "fill and publish /hydro/state": cost(lambda: publisher.publish(message.fill(10**18, 5, values, 3))),
    }
    node.destroy_node()
    rclpy.shutdown()
    return done


def write(folder: Path, samples: int) -> float:
    """Record that many samples; processor time [s]."""
    random, began = np.random.default_rng(0), time.process_time()
    with BagWriter(folder) as writer:
        for first in progress(range(0, samples, PIECE), label="write", unit=" pieces"):
            states = np.zeros(min(PIECE, samples - first), STATE_DTYPE)
            states["sequence"] = first + np.arange(len(states))
            states["time"] = 1.7e9 + 1e-3 * states["sequence"]
            for name in STATE_FIELDS:
                states[name] = np.sin(6e-3 * states["sequence"]) + 0.01 * random.standard_normal(len(states))
            writer.write_states(states)
    return time.process_time() - began


def timed(work: Callable[[], int]) -> tuple[int, float, float]:
    """Result, processor time [s], and the process' largest memory so far [MB]."""
    began = time.process_time()
    result = work()
    return result, time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bridge", description=__doc__)
    parser.add_argument("--seconds", type=int, default=600, help="length of the recording (default: %(default)s)")
    add_json_argument(parser)
    options = parser.parse_args()
    table = Table({"what": "", "value": "", "unit": ""}, title="The bridge's parts, processor time")
    for what, value in costs().items():
        table.add(what=what, value=value, unit="us")
    samples = 1000 * options.seconds
    with tempfile.TemporaryDirectory() as scratch:
        bag = Path(scratch) / "bag"
        seconds = write(bag, samples)
        streamed, streaming, bounded = timed(lambda: sum(map(len, stream_bag(bag))))
        read, reading, whole = timed(lambda: len(read_bag(bag).state))
    assert streamed == read == samples
    table.add(what="write a sample to a recording", value=1e6 * seconds / samples, unit="us")
    table.add(what=f"stream {options.seconds} s of recording", value=streaming, unit="s")
    table.add(what="memory, streaming", value=bounded, unit="MB")
    table.add(what=f"read {options.seconds} s of recording at once", value=reading, unit="s")
    table.add(what="memory, at once", value=whole, unit="MB")
    table.show(options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
