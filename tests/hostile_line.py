# SPDX-License-Identifier: Apache-2.0
"""Hostile bytes on the serial line of an armed plant, both ways at once: `make fuzz-line`.

python -m tests.hostile_line [--bytes N] [--rate N] [--seed N] [--json FILE]

Emulator, bridge and filter run; a commander tracks 200 N at 1 Hz with (90, 15). Between the whole frames of both ways a
stranger sends noise, damaged frames, frames of another version and frames that have passed before (`tests.soak.wire`).
What must hold, and is exit status 1 where it does not: all goes on, armed; no command acts that was not sent; every
sample comes once, in order; once the host's commands are kept from the box and the stranger's come still, the valve
has no current from 0.21 s on; it can be armed again after that; no memory grows.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.bags.recording import continuity, read_bag
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.ros.companion import Companion
from hydro_bridge.serial.stream import LinkCounts
from hydro_bridge.signals import Flag
from hydro_policy.nodes.startup.companions import PlantOptions
from tests.attacks import Defended
from tests.graph_probe import own_domain
from tests.soak.wire import Wire, resident

GROWTH = 8.0
"""MiB that a process may grow meanwhile."""
DEADLINE = 0.215
"""s after the last command: the box' watchdog of 200 ms, its period, and the way here."""
UNHEARD = 203
"""Samples of the box after the last command that it took: its watchdog of 200 ms, its period, and the way there."""
_MUTE = 1.0  # s without commands of the host's
_OWN = ((90.0, 15.0), (15.0, 5.0))


@dataclass
class Seen:
    """What the graph saw of it."""

    samples: int = 0
    """Recorded ones."""
    disarmed: int = 0
    """States of the box that were not armed while the host's commands passed."""
    disorder: int = 0
    """Samples that were recorded twice, or after a later one."""
    lost: int = 0
    """Samples that were not recorded."""
    foreign: int = 0
    """Samples with gains that nobody has asked for."""
    longest: float = 0.0
    """s after the last command at which the valve still had a current."""
    unheard: int = 0
    """Samples of the box after the last command that it took in which the valve still had a current."""
    forged: int = 0
    """States that answer a command which was never sent."""
    growth: float = 0.0
    """MiB, the largest of any process."""

    @property
    def unsafe(self) -> list[str]:
        """What must not be on any machine, however late it is."""
        found = {name: getattr(self, name) for name in ("disorder", "foreign", "forged")}
        wrong = [f"{name}: {count}" for name, count in found.items() if count]
        return wrong + ([f"current {self.unheard} samples after the last command"] if self.unheard > UNHEARD else [])

    @property
    def violations(self) -> list[str]:
        """What did not hold."""
        found = {name: getattr(self, name) for name in ("disarmed", "lost")}
        wrong = self.unsafe + [f"{name}: {count}" for name, count in found.items() if count]
        wrong += [f"current {self.longest:.3f} s after the last command"] if self.longest > DEADLINE else []
        return wrong + ([f"{self.growth:.1f} MiB more memory"] if self.growth > GROWTH else [])


def _disorder(found: LinkCounts) -> int:
    """Samples out of order; a step far back looks like a restart, and this box does not restart."""
    return found.duplicates + found.reordered + found.restarts


def look(bag: Path, seen: Seen) -> None:
    """What a recorder has heard of the plant."""
    states = read_bag(bag).state
    found = continuity(states)
    seen.samples, seen.lost, seen.disorder = len(states), found.lost, _disorder(found)
    states = states[(states["flags"] & Flag.ARMED) != 0]
    gains = np.stack([states["proportional_gain"], states["integral_gain"]], axis=1)
    own = [(np.abs(gains - np.array(pair)) < 1e-3).all(axis=1) for pair in _OWN]
    seen.foreign = int((~np.logical_or.reduce(own)).sum())


def attack(size: int, rate: float, seed: int, folder: Path) -> tuple[Seen, dict[str, Any]]:
    """Send `size` hostile bytes each way at `rate` bytes/ms: what the graph saw, and what the wire carried."""
    with ExitStack() as stack:
        stack.enter_context(own_domain())
        box, port, bag = folder / "box", folder / "port", folder / "bag"
        emulator = stack.enter_context(Companion("hydro_sim", "emulator", ["--link", str(box)]))
        wire = Wire(stack, box, port, seed)
        graph = Defended(folder, stack, options=PlantOptions(plant="bench", port=str(port), recording=bag))
        processes = {emulator, *graph.companions}
        graph.arm()
        wire.order(f"hostile {rate}")
        graph.drive(2.0)  # what buffers the first of it needs is no leak
        before = {each: resident(each.process.pid) for each in processes}
        disarmed = wire.report()["disarmed"]
        seen, sent = Seen(), 0
        deadline = time.monotonic() + 60.0 + 5e-3 * size / rate
        with progress(total=size, label="hostile bytes each way", unit=" bytes") as bar:
            while sent < size and time.monotonic() < deadline:
                graph.drive(1.0)
                graph.probe.forget()
                report = wire.report()
                seen.disarmed = report["disarmed"] - disarmed
                now = min(report[way]["hostile"] for way in ("up", "down"))
                bar.update(now - sent)
                sent = now
        wire.order(f"mute {_MUTE}")
        graph.drive(_MUTE)
        assert not graph.own_flags() & Flag.ARMED, "nobody commands it, and it is armed"
        report = wire.report()
        graph.arm()  # fails where it cannot go on
        seen.longest, seen.unheard, seen.forged = report["longest"], report["unheard"], report["forged"]
        assert sent >= size, f"{sent} of {size} bytes in {time.monotonic() - deadline:.0f} s"
        assert all(each.running for each in processes), [each.last_line for each in processes if not each.running]
        seen.growth = max(resident(each.process.pid) - before[each] for each in processes)
    look(bag, seen)
    return seen, report


@command()
def main() -> int:
    """Entry point; exit status 1 if something did not hold."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile_line", description=__doc__)
    parser.add_argument("--bytes", type=int, default=10_000_000, help="each way (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=100.0, help="hostile bytes a ms, each way (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: %(default)s)")
    add_json_argument(parser)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen, report = attack(asked.bytes, asked.rate, asked.seed, Path(folder))
    table = Table(
        {"what": "", "number": ""},
        title=f"{asked.bytes} hostile bytes each way of an armed plant's line, seed {asked.seed}",
    )
    ways = {f"{what} {way}": report[way][what] for way in ("up", "down") for what in ("frames", "hostile")}
    for name, number in {**ways, **vars(seen)}.items():
        table.add(what=name, number=number)
    table.show(asked.json)
    print("; ".join(seen.violations) or "all held")
    return 1 if seen.violations else 0


if __name__ == "__main__":
    sys.exit(main())
