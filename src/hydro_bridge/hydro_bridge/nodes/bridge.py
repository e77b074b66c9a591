# SPDX-License-Identifier: Apache-2.0
"""Bridge node: the box on the serial line as a plant of the graph.

ros2 run hydro_bridge bridge --port /dev/ttyUSB0 [--baud 2000000] [--bench FILE] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from hydro_bridge.arguments import parse_arguments, ros_arguments
from hydro_bridge.link.link import Link, LinkState
from hydro_bridge.nodes.plant_node import Corrector, PlantNode, arming_state
from hydro_bridge.plant_clock import LockStep, LockStepSettings
from hydro_bridge.ros.diagnostics import Level, Status
from hydro_bridge.ros.node import declare_parameters, request_realtime, run_node
from hydro_bridge.safety.box_info import bench_mismatches, describe_box
from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_bridge.serial.port import Port, PortLostError, PortSettings, PortTakenError
from hydro_bridge.serial.protocol import BoxInfo, State
from hydro_core.bench_scales import BenchScales
from hydro_core.cli.console import UserError, command
from hydro_core.files import bench_digest, site
from hydro_core.settings import add_options


class SerialPlant(Link):
    """Link to a box, with a status for /diagnostics."""

    bench_mismatches = ""
    """Differences between the box and its bench file, if any."""

    def status(self) -> Status:
        """Return the status for /diagnostics: port, box, counts and latencies."""
        statistics = self.statistics
        values = {
            "port": self.port.settings.path,
            "box": self.box.name if self.box else "",
            "box differs": self.bench_mismatches or "no",
            "refused by the box": self.refused[0],
            "references refused by the box": self.refused[1],
            **asdict(self.counts),
            "reconnects": statistics.reconnects,
            "dropped writes": self.port.dropped_writes,
            "commands sent": statistics.commands,
            "heartbeats": statistics.heartbeats,
            "state in to correction out": statistics.turnaround.summary(),
            "command out to confirmation in": statistics.round_trip.summary(),
            "low latency mode": self.port.low_latency,
            "each sample waits for": self.lock_step.peer_names if self.paced else "nobody: real time",
        }
        if self.state is not LinkState.CONNECTED:
            why = f": {self.last_fault}" if self.last_fault else ""
            return Status(level=Level.ERROR, message=f"no box: the port is {self.state.value}{why}", values=values)
        if mute := self.no_sample_message:
            return Status(level=Level.ERROR, message=f"no samples: {mute}", values=values)
        differs = f", the box differs: {self.bench_mismatches}" if self.bench_mismatches else ""
        return Status(
            level=Level.WARN if differs else Level.OK, message=arming_state(self.flags) + differs, values=values
        )


class BridgeNode(PlantNode):
    """Plant node over a serial line; `bench`: parameters in the box's bench file, if known."""

    def __init__(
        self, settings: PortSettings, bench: Mapping[str, Any] | None, corrector: Corrector | None, *, realtime: bool
    ) -> None:
        super().__init__("bridge", corrector)
        size = BenchScales.of_known_bench(bench)
        usual = GuardSettings() if size is None else GuardSettings.of_size(size)
        guard = CommandGuard(settings=declare_parameters(self, usual, "guard."))
        port = Port(declare_parameters(self, settings))
        logger, self._bench = self.get_logger(), bench
        lock_step = LockStep(declare_parameters(self, LockStepSettings(), "pace."), logger.info)
        self.link = SerialPlant(
            port, guard, partial(self._on_sample, self.publish_sample), logger.info, logger.warning, self._on_box,
            lock_step, partial(self._on_sample, self.correct),
        )  # fmt: skip
        self.connect(self.link)
        self.get_logger().info(f"this node runs under {request_realtime(realtime=realtime)}")

    def _on_sample(self, do: Callable[..., None], sample: State, stamp_ns: int, flags: int) -> None:
        do(stamp_ns, sample.sequence, sample.values, flags, sample.law_state)

    def _on_box(self, info: BoxInfo) -> None:
        mismatches = bench_mismatches(info, self._bench, self.link.details)
        self.link.bench_mismatches = mismatches
        if mismatches:
            self.get_logger().warning(f"{mismatches}: give the bridge the box's own bench.yaml by --bench")
        self.publish_box(describe_box(info, self._bench, "bridge", self.link.details), self.link.law)


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    result = argparse.ArgumentParser(
        prog="bridge",
        description="The box on a serial line as topics: /hydro/state; gains, correction, reference, /hydro/arm.",
        epilog="Limits, ages and time-outs are ROS parameters: --ros-args -p guard.delta_kp_max:=50.0. The plant is "
        "armed by the trainer, or by `ros2 run hydro_bridge arm`.",
    )
    result.add_argument("--port", default=PortSettings.path, help="device, or link to one; default %(default)s")
    add_options(result, PortSettings(), ["baud"])
    result.add_argument(
        "--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; default: the nominal bench"
    )
    site.add_site_option(result, "--bench")
    result.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if this user may")
    return result


def plant_factory(
    own: Sequence[str], ros: Sequence[str]
) -> tuple[Callable[[Corrector | None], BridgeNode], argparse.Namespace]:
    """Return a factory of the node, which takes the filter in this process or None, and its options.

    Raises UserError: the path is a file or a folder, or another program keeps the port for 2 s; a second bridge would
    answer /hydro/arm as well. A missing port may still appear: the link waits for it.
    """
    options = parse_arguments(parser(), "bridge", own, ros)
    site.apply_site_option(options, bench=site.BENCH_FILE)
    settings = PortSettings(path=options.port, baud=options.baud)
    file = options.bench or bench_digest.shipped_bench_file()
    bench = bench_digest.read_parameters(file) if file else None
    if bench and (bench.get("effects") or bench.get("closures")):
        raise UserError(f"{file} has effects or closures, it is a model: name the bench.yaml of the box")
    port, end = Port(settings), time.monotonic() + 2.0
    while True:
        try:
            port.open()
        except PortTakenError as error:
            if time.monotonic() > end:
                raise UserError(f"{error}; end that first, a box can have one bridge only") from None
            time.sleep(0.1)
        except PortLostError:
            break
        else:
            port.close()
            break
    return lambda corrector: BridgeNode(settings, bench, corrector, realtime=options.realtime), options


@command()
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    make, options = plant_factory(own, ros)
    run_node(lambda: make(None), ros, [options])
