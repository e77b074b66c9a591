# SPDX-License-Identifier: Apache-2.0
"""A training under faults drawn at random, by the hour: `make soak`; its hostile bytes alone: `make fuzz-line`.

python -m benchmarks.soak [--seed S] [--hours H] [--causes CAUSE ...] [--lasts S] [--json FILE]

Emulator, bridge, filter, trainer (external, from scratch) and recorder run at 1 kHz; a process on the serial line keeps
what the box says. Whatever ends is started again as its user would. Ctrl-C ends it with the table so far. Exit status 1
if something unsafe happened: not safe in time, a valve current without commands or beyond the valve's, a gain that none
asks for, an answer to a command that nobody sent, a process left behind, a traceback, memory that grows, no way on.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from random import Random

from tqdm import tqdm

from benchmarks.soak.faults import FAULTS
from benchmarks.soak.judge import Outcome
from benchmarks.soak.soak import soaking
from hydro_bridge.ros.node import restrict_to_localhost
from hydro_core.cli.console import Table, add_json_argument, bounded_number, command, progress, writable_folder
from hydro_core.process.termination import Terminated

COLUMNS = {
    "cause": "",
    "times": "",
    "safe_ms": "until disarmed with no current, or at base gains, the longest; none: it went on",
    "force_N": "the largest until then",
    "current_mA": "the largest until then",
    "back_s": "until a policy acted again, the longest",
}


def rows(outcomes: list[Outcome]) -> Table:
    """The outcomes by cause, in the order of the list of faults."""
    table = Table(COLUMNS, title="Faults")
    for fault in FAULTS:
        if own := [outcome for outcome in outcomes if outcome.cause == fault.cause]:
            safe = [1e3 * outcome.safe_after for outcome in own if outcome.safe_after is not None]
            back = [outcome.back_after for outcome in own if outcome.back_after is not None]
            table.add(
                cause=fault.cause, times=len(own), safe_ms=max(safe, default=None), back_s=max(back, default=None),
                force_N=max(outcome.force for outcome in own), current_mA=1e3 * max(outcome.current for outcome in own),
            )  # fmt: skip
    return table


def run(asked: argparse.Namespace, folder: Path) -> int:
    """Soak, and print what came of it."""
    ended = None
    chosen = [fault for fault in FAULTS if not asked.causes or fault.cause in asked.causes]
    chosen = [replace(fault, lasts=asked.lasts or fault.lasts) for fault in chosen]
    random, seconds = Random(asked.seed), 3600.0 * asked.hours
    turns = chain.from_iterable(random.sample(chosen, len(chosen)) for _ in count())
    bar: tqdm[None] = progress(total=round(seconds), label="soak", unit="s")
    with soaking(folder, asked.seed) as soak, bar:
        try:
            soak.run(chosen if asked.causes else turns, seconds, lambda now: bar.update(int(now) - bar.n))
        except Terminated as ending:
            ended = ending
    rows(soak.outcomes).show(asked.json)
    found = soak.violations()
    print(f"\n{len(soak.records)} samples; {soak.carried}", *(found or ["all held"]), sep="\n")
    if found:
        print(*soak.crew.text.splitlines()[-60:], sep="\n", file=sys.stderr)
    if ended is not None and not found:
        raise ended
    return 1 if found else 0


@command()
def main() -> int:
    """Entry point."""
    causes = [fault.cause for fault in FAULTS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of all that is random (default: %(default)s)")
    parser.add_argument("--hours", type=bounded_number(1e-3), default=1.0, help="default: %(default)s")
    parser.add_argument("--causes", nargs="+", choices=causes, metavar="CAUSE", help="only these faults, each once")
    parser.add_argument("--lasts", type=float, help="s that each lasts, in place of its own time")
    parser.add_argument("--keep", type=writable_folder, metavar="DIR", help="keep all files, the log among them, here")
    add_json_argument(parser)
    asked = parser.parse_args()
    restrict_to_localhost()
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # by nohup: all that is started would ignore it, too
        signal.signal(signal.SIGHUP, lambda *_: None)
    with tempfile.TemporaryDirectory() as folder:
        if asked.keep is not None:
            asked.keep.mkdir(parents=True, exist_ok=True)
        return run(asked, asked.keep or Path(folder))


if __name__ == "__main__":
    sys.exit(main())
