# SPDX-License-Identifier: Apache-2.0
"""A second filter, trainer, recorder and live page, then a second plant, beside an armed one: each told, and harmless.

python -m tests.second_nodes [--repeats N] [--json FILE]

Emulator, bridge and filter run; a commander tracks 200 N at 1 Hz with (90, 15). Exit status 1 if one was not told, if
the first did not go on beside filter, trainer, recorder and page, or was not disarmed beside a second plant.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli.console import Table, add_json_argument, command
from hydro_bridge.ros import CORRECTION, STATE, Companion
from hydro_bridge.signals import Flag
from tests.attacks import Defended, defended
from tests.graph_probe import trainer

_PATIENCE = 90.0  # s, for imports on a busy machine


@dataclass
class Beside:
    """What came of second nodes."""

    filter: bool = False
    """The second filter said that another answers already, and had no publisher of corrections."""
    trainer: bool = False
    """The second trainer said who commands, and waited."""
    recorder: bool = False
    """Each of two recorders said that there is another, and both recordings have all samples meanwhile."""
    went_on: bool = False
    """All samples meanwhile were armed."""
    dashboard: bool = False
    """Each of two live pages said that there is another."""
    plant: bool = False
    """Beside a second plant the first was disarmed, and said why."""

    @property
    def held(self) -> bool:
        """Whether all of it held."""
        return all(vars(self).values())


def beside(graph: Defended, folder: Path, *, tools: bool = True) -> Beside:
    """Start second ones beside the armed plant of `graph`, one after another; their files go into `folder`.

    Without `tools` no recorders and pages, which command nothing.
    """
    found, probe, said = Beside(), graph.probe, io.StringIO()
    words = ("--plant", "external", "--from", "scratch", "--rearm", "auto", "--runs", str(folder), "--name", "run")
    told = "probe commands this plant: end it"
    graph.arm()
    probe.forget()
    with Companion("hydro_filter", "filter", [], output=said):
        graph.drive(_PATIENCE, until=lambda: "answers already" in said.getvalue())
        graph.drive(1.0)
        found.filter = "answers already" in said.getvalue() and probe.node.count_publishers(CORRECTION) == 1
    found.recorder = not tools or beside_a_recorder(graph, folder)
    found.dashboard = not tools or beside_a_page(graph)
    with trainer(*words) as process:  # last: while it ends nobody drives
        graph.drive(_PATIENCE, until=lambda: told in process.text)
        graph.drive(3.0)
        found.trainer = told in process.text and process.process.poll() is None
    found.went_on = all(state.flags & Flag.ARMED for _, state in probe.heard[STATE])
    if not found.went_on:
        print("not armed all the time:", *graph.text[-40:], sep="\n", file=sys.stderr)
    found.plant = beside_a_plant(graph)
    return found


def beside_a_recorder(graph: Defended, folder: Path) -> bool:
    """Start two recorders: whether each told of the other, and both recorded the same, whole but for a hundredth."""
    said, bags = [io.StringIO(), io.StringIO()], [folder / "first", folder / "second"]
    with ExitStack() as stack:
        for bag, output in zip(bags, said, strict=True):
            stack.enter_context(Companion("hydro_bridge", "recorder", ["--out", str(bag)], output=output))
            graph.drive(_PATIENCE, until=lambda output=output: "recording into" in output.getvalue())  # type: ignore[misc]
        graph.drive(_PATIENCE, until=lambda: all("another recorder" in output.getvalue() for output in said))
        graph.drive(3.0)
    first, second = (read_bag(bag).state["sequence"] for bag in bags)
    both = np.intersect1d(first, second)
    whole = len(both) > 2000 and len(both) > 0.99 * (both[-1] - both[0] + 1)
    return whole and all("another recorder" in output.getvalue() for output in said)


def beside_a_page(graph: Defended) -> bool:
    """Start two live pages: whether each told of the other."""
    said = [io.StringIO(), io.StringIO()]
    with ExitStack() as stack:
        for output in said:
            stack.enter_context(Companion("hydro_bridge", "dashboard", ["--port", "0"], output=output))
            graph.drive(_PATIENCE, until=lambda output=output: "the live page" in output.getvalue())  # type: ignore[misc]
        graph.drive(_PATIENCE, until=lambda: all("another live page" in output.getvalue() for output in said))
    return all("another live page" in output.getvalue() for output in said)


def beside_a_plant(graph: Defended) -> bool:
    """Start a second plant beside the armed one: whether that one was disarmed, and said why."""
    graph.arm()
    begun = len(graph.text)

    def told() -> bool:
        lines = graph.text[begun:]  # one before has brought the same words
        return any("2 nodes publish /hydro/state" in line and "disarmed until" in line for line in lines)

    second = Companion("hydro_sim", "sim", ["--model", "analytic"], output=io.StringIO())
    try:
        graph.drive(_PATIENCE, until=told)
        graph.drive(0.5)
        return told() and not graph.own_flags() & Flag.ARMED
    finally:
        second.stop()


@command()
def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m tests.second_nodes", description=__doc__)
    parser.add_argument("--repeats", type=int, default=20, metavar="N", help="default: %(default)s")
    add_json_argument(parser)
    asked = parser.parse_args()
    rows: list[Beside] = []
    with tempfile.TemporaryDirectory() as folder, defended(Path(folder)) as graph:
        for number in range(asked.repeats):
            own = Path(folder, f"{number}")
            own.mkdir()
            rows.append(beside(graph, own))
            print(number, rows[-1], file=sys.stderr, flush=True)
    table = Table({"what": "", "held": ""}, title="Second nodes beside an armed plant")
    for name in vars(Beside()):
        table.add(what=name, held=f"{sum(getattr(row, name) for row in rows)} of {len(rows)}")
    table.show(asked.json)
    return 0 if all(row.held for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
