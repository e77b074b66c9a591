# SPDX-License-Identifier: Apache-2.0
"""The filter: a Correction for every BenchState, also when there is nothing to correct, so that silence means dead.

ros2 run hydro_filter filter [--bench FILE] [--contraction-rate 0.1] [--every 10] [--bypass] [--realtime] [--ros-args]

States are answered in order, each once. After a hold-up those older than `state_age_max` are answered STALE without
being evaluated, which takes the backlog away faster than it grows.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from rclpy.node import Node

from hydro_bridge.console import command
from hydro_bridge.ros import (
    CORRECTION,
    CORRECTION_QOS,
    STATE,
    STATE_QOS,
    DiagnosticsPublisher,
    Level,
    Status,
    be_prompt,
    declare_parameters,
    ros_arguments,
    run_node,
    seconds,
)
from hydro_bridge.settings import check, describe
from hydro_bridge.signals import PLANT_FIELDS, CorrectionStatus, Flag
from hydro_filter.filter import ContractionFilter, FilterSettings, Result
from hydro_filter.sample import Sample
from hydro_filter.tally import TROUBLE, Tally, sentence
from hydro_msgs.msg import BenchState, Correction
from hydro_sim.bench import Bench


class FilterNode(Node):
    """Moves states to the filter and corrections out.

    Parameters
    ----------
    bench
        What the filter believes.
    settings
        Defaults of the ROS parameters.
    every
        Answer every so manieth sample (of the sequence), 1 or more; 10 is the paper's 100 Hz.
    realtime
        Ask for SCHED_FIFO.
    """

    def __init__(self, bench: Bench, settings: FilterSettings, *, every: int = 1, realtime: bool = False) -> None:
        super().__init__("filter")
        self.settings = declare_parameters(self, settings)
        self.filter = ContractionFilter.for_bench(bench, self.settings)
        self.tally = Tally()
        self._every = every
        self._message = Correction()
        self._publisher = self.create_publisher(Correction, CORRECTION, CORRECTION_QOS)
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        self.filter.correct(Sample(np.zeros(len(PLANT_FIELDS)), 0.0, 0.0, 0.0))  # compiles now, not at the first sample
        scheduling = be_prompt(realtime=realtime)
        self.get_logger().info(f"contraction rate {self.settings.contraction_rate:g} 1/s, {scheduling}")
        if self.settings.bypass:
            self.get_logger().error("BYPASSED: nothing is corrected; plants that require the filter stay at base gains")
        self.create_subscription(BenchState, STATE, self._on_state, STATE_QOS)  # last: states wait from now on

    def _on_state(self, message: BenchState) -> None:
        begin = time.perf_counter()
        self.tally.expect(message.sequence)
        if message.sequence % self._every:
            return
        stamp = seconds(message.header.stamp)
        result = self.filter.correct(sample_of(message), self._now() - stamp)
        self._publish(message, result)
        self.tally.add(result.status, time.perf_counter() - begin, self._now() - stamp)

    def _publish(self, state: BenchState, result: Result) -> None:
        message = self._message
        message.header = state.header
        message.sequence = state.sequence
        message.delta_u, message.certificate_before, message.certificate_after, _ = result
        message.active = result.delta_u != 0.0
        message.infeasible = result.status in (CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE)
        message.status = int(result.status)
        self._publisher.publish(message)

    def _now(self) -> float:
        return 1e-9 * float(self.get_clock().now().nanoseconds)

    def _status(self) -> Status:
        news = self.tally.news()
        told = sentence(news)
        level = Level.OK
        if not news:
            level, told = Level.STALE, "no states"
        elif any(news[status] for status in TROUBLE):
            level = Level.WARN
            self.get_logger().warning(told, throttle_duration_sec=5.0)
        if self.settings.bypass:
            level, told = Level.ERROR, f"BYPASSED, nothing is corrected; {told}"
            self.get_logger().error(told, throttle_duration_sec=10.0)
        return Status(level=level, message=told, values=self.tally.values(self.filter.qp.counts))


def sample_of(message: BenchState) -> Sample:
    """What the filter reads of a BenchState."""
    state = np.array([getattr(message, name) for name in PLANT_FIELDS])
    return Sample(
        state, message.nominal_valve_current, message.reference_force, message.proportional_gain,
        message.valve_current, message.reference_force_rate, bool(message.flags & Flag.ARMED),
    )  # fmt: skip


def arguments(given: list[str]) -> argparse.Namespace:
    """Parse the command line; its options and the ROS parameters of the same names have one meaning."""
    docs, default = describe(FilterSettings), FilterSettings()
    parser = argparse.ArgumentParser(
        prog="filter", description="Contraction filter: /hydro/state to /hydro/correction."
    )
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml; default: the nominal bench")
    for name in ("contraction_rate", "noise_floor", "state_age_max"):
        option = "--" + name.replace("_", "-")
        parser.add_argument(option, type=float, default=getattr(default, name), metavar="NUMBER", help=docs[name].text)
    parser.add_argument("--every", type=int, default=1, metavar="N", help="answer every Nth sample; 10 is 100 Hz")
    parser.add_argument("--bypass", action="store_true", help=docs["bypass"].text)
    parser.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, if permitted")
    asked = parser.parse_args(given)
    if asked.every < 1:
        parser.error("--every needs 1 or more")
    return asked


@command(ValueError)
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    asked = arguments(own)
    bench = Bench.load(asked.bench) if asked.bench else Bench.nominal()
    settings = FilterSettings(
        contraction_rate=asked.contraction_rate,
        noise_floor=asked.noise_floor,
        state_age_max=asked.state_age_max,
        bypass=asked.bypass,
    )
    check(settings)
    run_node(lambda: FilterNode(bench, settings, every=asked.every, realtime=asked.realtime), ros)


if __name__ == "__main__":
    main()
