# SPDX-License-Identifier: Apache-2.0
"""The simulated bench in the place of emulator and bridge: same topics, types, rates and rules.

ros2 run hydro_sim sim [--bench FILE] [--speed S] [--noise SCALE] [--seed N] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict, replace

from rosgraph_msgs.msg import Clock

from hydro_bridge.guard import CommandGuard, GuardSettings
from hydro_bridge.nodes.plant_node import PlantNode
from hydro_bridge.ros import Level, Status, declare_parameters, ros_arguments, run_node
from hydro_bridge.settings import describe
from hydro_bridge.signals import Flag
from hydro_msgs.msg import Gains
from hydro_sim.bench import Bench
from hydro_sim.box import Box, BoxConfig
from hydro_sim.plant import AnalyticPlant
from hydro_sim.simulation import SimSettings, Simulation


class SimSide(Simulation):
    """A simulation that can say on /diagnostics how it is doing."""

    def status(self) -> Status:
        """See `hydro_bridge.nodes.plant_node.PlantSide`."""
        pace = "in lock-step" if self.steps.engaged else f"at {self.speed_reached():.2f} times real time"
        name = "tripped" if self.flags & Flag.TRIPPED else "armed" if self.flags & Flag.ARMED else "disarmed"
        with self.lock:
            counts = asdict(self.guard.counts)
        values = {
            "samples": self.samples,
            "speed": self.speed_reached(),
            "flags": self.flags.name or "none",
            "late samples": self.pacer.late,
            "lateness": self.pacer.lateness.sentence(),
            "left out [s]": self.pacer.skipped,
            **counts,
        }
        return Status(
            level=Level.WARN if self.flags & Flag.TRIPPED else Level.OK, message=f"{name}, {pace}", values=values
        )


class SimNode(PlantNode):
    """Plant node over a simulation."""

    def __init__(self, settings: SimSettings) -> None:
        super().__init__("sim")
        settings = declare_parameters(self, settings)
        guard = CommandGuard(settings=declare_parameters(self, GuardSettings(), "guard."))
        box_config = declare_parameters(self, BoxConfig(), "box.")
        bench = Bench.load(settings.bench) if settings.bench else Bench.nominal()
        plant = AnalyticPlant(bench, noise=settings.noise)
        log = self.get_logger().info
        self._clock_publisher = None if settings.speed == 1.0 else self.create_publisher(Clock, "/clock", 10)
        self._time = Clock()
        self.simulation = SimSide(Box(bench, box_config), plant, guard, settings, self._publish, log)
        self.connect(self.simulation, self.simulation.clock)
        self._thread = threading.Thread(target=self.simulation.run, name="plant", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the plant's thread."""
        self.simulation.stop()
        self._thread.join(2.0)

    def _publish(self, stamp_ns: int, fields: tuple[float, ...]) -> None:
        if self._clock_publisher is not None:
            self._time.clock.sec, self._time.clock.nanosec = divmod(stamp_ns, 1_000_000_000)
            self._clock_publisher.publish(self._time)
        self.publish_state(stamp_ns, int(fields[1]), fields[2:-1], int(fields[-1]))

    def _on_gains(self, message: Gains) -> None:
        super()._on_gains(message)
        self.simulation.gained()


def arguments(own: Sequence[str]) -> SimSettings:
    """Settings from the command line; the help texts are the settings' own."""
    parser = argparse.ArgumentParser(prog="sim", description="The simulated bench in the place of emulator and bridge.")
    texts, defaults = describe(SimSettings), SimSettings()
    for name in ("bench", "speed", "noise", "seed"):
        default = getattr(defaults, name)
        parser.add_argument(f"--{name}", type=type(default), default=default, help=texts[name].text)
    return replace(defaults, **vars(parser.parse_args(own)))


def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    try:
        settings = arguments(own)
        run_node(lambda: SimNode(settings), ros)
    except ValueError as error:
        sys.exit(_refuse(error))


def _refuse(error: Exception) -> int:
    print(f"sim: {error}", file=sys.stderr)
    return 2
