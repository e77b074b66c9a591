# SPDX-License-Identifier: Apache-2.0
"""The whole graph on this machine: box frame in to correction frame out, CPU per process, lost samples.

Emulator (on its pseudo-terminal), bridge, filter and recorder run as processes, then again with bridge and filter in
one; gains come at 100 Hz from here, as a trainer's would. The bridge measures the latency, from a state frame's arrival
to the command frame that carries its correction, and tells it on /diagnostics. Under `--law compensated` this process
has the law's estimator too, and the filter needs --model and --metric of a bench file (learn_metric makes the metric).
"""

from __future__ import annotations

import argparse
import os
import shlex
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor

from benchmarks._report import parser
from hydro_bridge.bags.recording import read_bag
from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import DIAGNOSTICS, LAW_STATE, STATE, create_subscription
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.cli.console import Table, UserError, command
from hydro_core.signals import Law, ReferenceSignal, Waveform
from hydro_msgs.msg import BenchState, LawState
from hydro_policy.compensation.live import LiveCompensation

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)


class Driver:
    """The stand-in for a trainer: arms, sets the reference, publishes gains, listens to diagnostics."""

    def __init__(self, law: Law) -> None:
        rclpy.init()
        self._largest = (75.0, 10.0) if law is Law.PAPER else (0.0, 0.0)  # changes of K_p and K_i
        self.node = rclpy.create_node("benchmark")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.told: dict[str, dict[str, str]] = {}
        create_subscription(self.node, DIAGNOSTICS, self._on_diagnostics)
        self._commander = Commander(self.node)
        self._commander.publish_reference(SINE)
        self._rng = np.random.default_rng(0)
        self._step = 0
        self._live = LiveCompensation(BoxLaw()) if law is Law.COMPENSATED else None
        if self._live is not None:
            create_subscription(self.node, STATE, self._on_state)
            create_subscription(self.node, LAW_STATE, self._on_law_state)

    def wait(self, condition: Callable[[], bool], otherwise: str, timeout: float = 30.0) -> None:
        """Wait for a condition; raises UserError with a sentence if it does not come."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                raise UserError(otherwise)
            self.executor.spin_once(timeout_sec=0.1)

    def arm(self) -> None:
        """Arm once the box answers."""
        deadline, answer = time.monotonic() + 30.0, "no plant"
        while time.monotonic() < deadline:
            if (future := self._commander.arm(True)) is not None:
                self.executor.spin_until_future_complete(future, timeout_sec=2.0)
                if future.done() and future.result().success:
                    return
                answer = future.result().message if future.done() else "no answer"
            self.run(0.5)
        raise UserError(f"the plant could not be armed: {answer}")

    def run(self, seconds: float) -> None:
        """Publish gains at 100 Hz for a while."""
        begin, steps = time.monotonic(), 0
        while (left := begin + seconds - time.monotonic()) > 0:
            due = steps * 0.01 - (seconds - left)
            if due > 0:
                self.executor.spin_once(timeout_sec=due)
                continue
            steps, self._step = steps + 1, self._step + 1
            self._commander.renew_lease(time.monotonic())
            if self._live is not None:
                self._commander.publish_law(self._live.command, self._step)
            delta_kp, delta_ki = self._rng.uniform((0.0, 0.0), self._largest)
            self._commander.publish_gains(delta_kp, delta_ki, self._step)

    def close(self) -> None:
        """End."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _on_state(self, state: BenchState) -> None:
        assert self._live is not None
        self._live.on_sample(state.sequence, state.load_force, state.flags, state.reference_force_rate)

    def _on_law_state(self, state: LawState) -> None:
        assert self._live is not None
        self._live.on_law_state(state.sequence, state.law, state.compensated_reference)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.told[status.name] = {pair.key: pair.value for pair in status.values}


def cpu_seconds(process: int) -> float:
    """User and system time [s] of a process with all its threads, from /proc."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def start(
    stack: ExitStack, driver: Driver, folder: Path, metric: Sequence[str], together: bool
) -> dict[str, Companion]:
    """Start the graph one after the other; the percentiles in the diagnostics begin with a graph that is whole."""
    port = folder / "box"
    line = ["--port", str(port), "--realtime"]
    plant = {"filter": ("hydro_filter", [*metric, "--realtime"]), "bridge": ("hydro_bridge", line)}
    if together:
        plant = {"filtered_plant": ("hydro_filter", ["bridge", f"--filter={shlex.join(metric)}", *line])}
    commands = {
        "emulator": ("hydro_sim", ["--link", str(port), "--pace", "real"]), **plant,
        "recorder": ("hydro_bridge", ["--out", str(folder / "bag")]),
    }  # fmt: skip
    running: dict[str, Companion] = {}
    for name, (package, arguments) in commands.items():
        running[name] = stack.enter_context(Companion(package, name, arguments))
        if name == "emulator":
            driver.wait(port.exists, f"{port} does not appear")
        elif name in plant and name != "bridge":  # which may have to compile
            driver.wait(lambda: "filter" in driver.told, "the filter does not tell its diagnostics", 120.0)
    driver.arm()
    return running


def measure(asked: argparse.Namespace, folder: Path, *, together: bool) -> dict[str, str]:
    """Run the graph; return what was seen by row of the table."""
    metric = ["--metric", asked.metric, *(["--model", str(asked.model)] if asked.model else [])]
    with ExitStack() as stack:
        driver = Driver(Law[asked.law.upper()])
        stack.callback(driver.close)
        running = start(stack, driver, folder, metric, together)
        driver.run(2.0)
        before = {name: cpu_seconds(companion.process.pid) for name, companion in running.items()}
        begin = time.monotonic()
        driver.run(asked.seconds)
        elapsed = time.monotonic() - begin
        cpu = {name: cpu_seconds(companion.process.pid) - before[name] for name, companion in running.items()}
        driver.run(1.2)  # the last diagnostics
    states = read_bag(folder / "bag").state
    bridge, own = driver.told.get("bridge", {}), driver.told.get("filter", {})
    statuses = ("pass", "modified", "relaxed", "infeasible", "nan", "stale")
    plant = sum(cpu.get(name, 0.0) for name in ("bridge", "filter", "filtered_plant"))
    missing = int((np.diff(states["sequence"].astype(np.int64)) - 1).sum())
    return {
        "box frame in to correction frame out": bridge.get("state in to correction out", "not told"),
        "command out to confirmation in": bridge.get("command out to confirmation in", "not told"),
        "filter: sample to decision": "  ".join(
            f"{key} {own.get(f'work_{key}_ms', '?')}" for key in ("p50", "p99", "p99_9")
        )
        + " ms",
        "filter: corrections": ", ".join(f"{own.get(key, '?')} {key}" for key in (*statuses, "missing_states")),
        "bridge and filter: share of a core": f"{plant / elapsed:.1%}",
        **{f"{name}: share of a core": f"{cpu[name] / elapsed:.1%}" for name in ("emulator", "recorder")},
        "recording: samples, missing sequence numbers": f"{len(states)}, {missing}",
        "bridge: heartbeats (commands without a correction)": bridge.get("heartbeats", "not told"),
    }


@command()
def main() -> None:
    """Measure, print, write."""
    options = parser("latency", __doc__)
    options.add_argument("--seconds", type=float, default=20.0, help="default 20")
    options.add_argument("--metric", default="learned", help="of the filter: learned (default) or a file")
    options.add_argument("--model", type=Path, metavar="FILE", help="bench file of that metric")
    options.add_argument("--law", default="paper", choices=("paper", "compensated"), help="default %(default)s")
    asked = options.parse_args()
    seen = []
    for together in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            seen.append(measure(asked, Path(folder), together=together))
    title = (f"Graph under the {asked.law} law with the {asked.metric} metric for {asked.seconds:g} s on "
             f"{os.cpu_count()} cores, SCHED_FIFO for bridge and filter")  # fmt: skip
    table = Table({"what": "", "apart": "bridge and filter as two processes", "one": "in one"}, title=title)
    for what in seen[0]:
        table.add(what=what, apart=seen[0][what], one=seen[1][what])
    table.show(asked.json)


if __name__ == "__main__":
    main()
