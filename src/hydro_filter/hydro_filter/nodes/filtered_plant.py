# SPDX-License-Identifier: Apache-2.0
"""A plant node with the filter in its process: the plant hands over each sample and gets its correction at once.

ros2 run hydro_filter filtered_plant bridge|sim [options of that node] [--ros-args -p filter:contraction_rate:=2.0]

Nodes, topics and parameters are those of `bridge` or `sim` and of `filter` as separate processes; the filter's options
are its parameters. Between the two nothing crosses the middleware
(docs/decisions/0084-bridge-and-filter-in-one-process.md).
"""

from __future__ import annotations

import argparse
import re

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.nodes import bridge
from hydro_bridge.ros.node import run_node
from hydro_core.cli.console import UserError, command
from hydro_filter.controller.factory import parse_args
from hydro_filter.nodes.filter import FilterNode
from hydro_sim.nodes import sim

PLANT_FACTORIES = {"bridge": bridge.plant_factory, "sim": sim.plant_factory}


@command(ValueError)
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="filtered_plant",
        description="A plant and the filter in one process: same nodes and topics as side by side, less work.",
        epilog="Further options are the plant's: `filtered_plant bridge --port /dev/ttyUSB0`; see `bridge --help`. "
        "Those of the filter are its parameters: `--ros-args -p filter:metric:=FILE`.",
        allow_abbrev=False,
    )
    parser.add_argument("plant", choices=tuple(PLANT_FACTORIES), help="which node")
    own, ros = ros_arguments()
    asked, words = parser.parse_known_args(own)
    choice, settings, filtering = parse_args([], ros)
    if any(re.match(r"__(node|name):=", word) for word in ros):
        raise UserError(f"two nodes are here: say which by -r {asked.plant}:__node:=NAME or -r filter:__node:=NAME")
    choice.describe()  # a missing file is refused before ROS starts
    make, options = PLANT_FACTORIES[asked.plant](words, ros)
    run_node(lambda: make(FilterNode(choice, settings, in_process=True)), ros, [options, filtering])
