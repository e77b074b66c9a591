# SPDX-License-Identifier: Apache-2.0
"""A plant node with the filter in its process: the plant hands over each sample and gets its correction at once.

ros2 run hydro_filter filtered_plant bridge|sim [options of that node] [--filter "WORDS"]

Nodes, topics and parameters are those of `bridge` or `sim` and of `filter` as separate processes. Between the two
nothing crosses the middleware (docs/decisions/0084-bridge-and-filter-in-one-process.md).
"""

from __future__ import annotations

import argparse
import re
import shlex

from hydro_bridge.nodes import bridge
from hydro_bridge.ros.node import ros_arguments, run_node
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
        epilog="Further options are the plant's: `filtered_plant bridge --port /dev/ttyUSB0`; see `bridge --help`.",
        allow_abbrev=False,
    )
    parser.add_argument("plant", choices=tuple(PLANT_FACTORIES), help="which node")
    parser.add_argument("--filter", default="", metavar="WORDS", help='of the filter: --filter="--contraction-rate 2"')
    own, ros = ros_arguments()
    asked, words = parser.parse_known_args(own)
    choice, settings, filtering = parse_args(shlex.split(asked.filter))
    if filtering.realtime:
        raise UserError("--realtime is the plant's: say it outside of --filter")
    if any(re.match(r"__(node|name):=", word) for word in ros):
        raise UserError(f"two nodes are here: say which by -r {asked.plant}:__node:=NAME or -r filter:__node:=NAME")
    choice.describe()  # a missing file is refused before ROS starts
    make = PLANT_FACTORIES[asked.plant](words)
    run_node(lambda: make(FilterNode(choice, settings, in_process=True)), ros)
