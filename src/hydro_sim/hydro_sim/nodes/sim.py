# SPDX-License-Identifier: Apache-2.0
"""The simulated bench in place of emulator and bridge: same topics, types, rates and rules.

ros2 run hydro_sim sim [--model FILE | shipped | analytic] [--bench FILE] [--box-bench FILE] [--pace plant|real|FACTOR]
                       [--noise SCALE] [--seed N] [--realtime] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from hydro_bridge.arguments import parse_arguments, ros_arguments
from hydro_bridge.nodes.plant_node import Corrector, PlantNode, arming_state
from hydro_bridge.plant_clock import LockStep, LockStepSettings
from hydro_bridge.ros.diagnostics import Status
from hydro_bridge.ros.node import declare_parameters, request_realtime, run_node
from hydro_bridge.safety.box_info import describe_box
from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_core.cli.console import command
from hydro_core.files import site
from hydro_core.settings import add_options
from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.box.box import Box, BoxConfig, box_info
from hydro_sim.files import learned_bench
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import Sensors
from hydro_sim.simulation.realtime import SimSettings, Simulation


class SimulatedPlant(Simulation):
    """Simulation with a status for /diagnostics."""

    effects = ""
    """Labels of the simulated effects."""

    def status(self) -> Status:
        """Return the status for /diagnostics; see `hydro_bridge.safety.plant_interface.PlantInterface`."""
        speed = self.samples * SAMPLE_PERIOD / max(time.monotonic() - self.began, SAMPLE_PERIOD)
        values = {
            "samples": self.samples,
            "simulated seconds per second": speed,
            "late samples": self.timer.late,
            "lateness": self.timer.lateness.summary(),
            "left out [s]": self.timer.skipped,
            "each sample waits for": self.lock_step.peer_names if self.paced else f"nobody: {self.settings.pace}",
            "effects": self.effects or "none",
            "refused by the box": self._box.refused[0],
        }
        return Status(message=f"{arming_state(self.flags)}, {speed:.2f} times real time", values=values)


class SimNode(PlantNode):
    """Plant node of a simulation."""

    def __init__(self, settings: SimSettings, corrector: Corrector | None = None, *, realtime: bool) -> None:
        super().__init__("sim", corrector)
        settings = declare_parameters(self, settings)
        bench = Bench.load(settings.bench) if settings.bench else Bench.nominal()
        believed = Bench.load(settings.box_bench) if settings.box_bench else bench
        guard = CommandGuard(settings=declare_parameters(self, GuardSettings.of_size(believed.size), "guard."))
        config = declare_parameters(self, BoxConfig().of_bench(believed), "box.")
        box, name = Box(believed, config), settings.model or ("analytic" if settings.bench else "shipped")
        if name != "analytic":
            path, identity = None if name == "shipped" else name, settings.box_bench or settings.bench or None
            remedy = "name the bench.yaml of its box by --box-bench, or simulate the bench file: --model analytic"
            learned_bench.require_match(path, BoxIdentity.of_file(identity), remedy)
            bench = learned_bench.read(path)
        plant = AnalyticPlant(bench, noise=settings.noise, settings=Sensors.of_size(bench.size))
        effects = ", ".join(map(label, bench.terms))
        what = f"its effects: {effects}" if effects else "without an effect beyond its numbers"
        log = self.get_logger().info
        log(f"simulates {settings.model or settings.bench or 'the shipped learned bench'}, {what}")
        lock_step = LockStep(declare_parameters(self, LockStepSettings(), "pace."), log)
        self.simulation = SimulatedPlant(box, plant, guard, settings, self._publish, log, lock_step)
        self.simulation.effects = effects
        self.connect(self.simulation)
        info = box_info(believed, config, "hydro sim")
        guard.valve_current_max = info.valve_current_max
        self._known, self._law = describe_box(info, believed.to_mapping(), self.get_name()), config.compensated
        self.simulation.warm_up()  # not by SCHED_FIFO: compiling takes seconds on end
        log(f"this node runs under {request_realtime(realtime=realtime and self.simulation.real_time)}")

    def begin(self) -> None:
        """Start the plant's thread, once all settings are valid."""
        self.publish_box(self._known, self._law)
        super().begin()

    def _publish(self, stamp_ns: int, fields: tuple[Any, ...]) -> None:
        _, sequence, *values, flags = fields
        sample = stamp_ns, sequence, values, flags, self.simulation.law_state
        self.correct(*sample)
        self.publish_sample(*sample)


def plant_factory(
    own: Sequence[str], ros: Sequence[str]
) -> tuple[Callable[[Corrector | None], SimNode], argparse.Namespace]:
    """Return a factory of the node, which takes the filter in this process or None, and its options."""
    parser = argparse.ArgumentParser(
        prog="sim",
        description="The simulated bench in place of emulator and bridge: same topics, types, rates and rules.",
        epilog="Limits and time-outs of guard and box are ROS parameters: --ros-args -p box.load_force_limit:=600.0.",
    )
    names = [field.name for field in fields(SimSettings)]
    add_options(parser, SimSettings(), names)
    site.add_site_option(parser, "--bench and --model")
    parser.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if this user may")
    asked = parse_arguments(parser, "sim", own, ros)
    site.apply_site_option(asked, bench=site.BENCH_FILE, model=site.MODEL_FILE)
    given: dict[str, Any] = {name: getattr(asked, name) for name in names}
    given |= {name: str(given[name]) for name in ("model", "bench")}  # a Path by --site
    settings = SimSettings(**given)
    return lambda corrector: SimNode(settings, corrector, realtime=asked.realtime), asked


@command(ValueError)
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    make, options = plant_factory(own, ros)
    run_node(lambda: make(None), ros, [options])
