# SPDX-License-Identifier: Apache-2.0
"""Try over the line whether a box keeps the protocol: ros2 run hydro_bridge conformance --port PORT --bench FILE.

Without --moving nothing is sent that arms the box, and the piston rests. End the bridge first: the port is for one.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress
from hydro_bridge.conformance.cases import FAIL, LEFT_OUT, NOT_JUDGED, PASS, Case, Result, run, shipped
from hydro_bridge.conformance.host import Host
from hydro_bridge.files import bench_file
from hydro_bridge.serial.port import Port, PortSettings, no_port

_LATE = 3
"""Exit status where nothing failed and something was not judged; 2 is that of a wrong command line."""

COLUMNS = {
    "case": "what was tried",
    "result": "pass, FAIL, left out, or not judged: this host was late twice",
    "found": "why it did not pass, or what was not looked at",
    "says": "what must hold",
}


def parser() -> argparse.ArgumentParser:
    """Parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="conformance", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", help="device of the box, or link to one")
    parser.add_argument("--baud", type=int, default=PortSettings().baud, help="bit/s; default: %(default)s")
    parser.add_argument(
        "--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; absent: not tried"
    )
    parser.add_argument(
        "--moving", action="store_true", help="also what arms the box: the piston moves, by some 60 N about its rest"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="CASE", help="ids, or their beginnings")
    parser.add_argument("--list", action="store_true", dest="listed", help="show the cases and end")
    add_json_argument(parser)
    return parser


def chosen(cases: tuple[Case, ...], beginnings: list[str]) -> tuple[Case, ...]:
    """The cases whose id begins with one of these; all without any.

    Raises
    ------
    UserError
        One of them is the beginning of none.
    """
    for each in beginnings:
        if not any(case.id.startswith(each) for case in cases):
            raise UserError(f"--only {each}: no case begins so; --list shows them")
    return tuple(case for case in cases if not beginnings or case.id.startswith(tuple(beginnings)))


def table(results: list[Result]) -> Table:
    """The results for people and programs."""
    outcomes = (PASS, FAIL, LEFT_OUT, NOT_JUDGED)
    counts = {outcome: sum(result.outcome == outcome for result in results) for outcome in outcomes}
    made = Table(COLUMNS, title=", ".join(f"{count} {outcome}" for outcome, count in counts.items()))
    for result in results:
        made.add(case=result.case.id, result=result.outcome, found=result.found, says=result.case.says)
    return made


def status(results: list[Result]) -> int:
    """The exit status."""
    found = {result.outcome for result in results}
    return 1 if FAIL in found else _LATE if NOT_JUDGED in found else 0


@command()
def main() -> int:
    """Entry point; exit status 1 if a case failed, else 3 if this host was too late to judge one."""
    options = parser().parse_args()
    cases = chosen(shipped(), options.only)
    if options.listed:
        listing = Table({"case": "", "moving": "", "needs": "", "says": ""})
        for case in cases:
            listing.add(case=case.id, moving="moving" if case.moving else "", needs=case.needs, says=case.says)
        listing.show(options.json)
        return 0
    if options.port is None:
        raise UserError("--port: which device is the box at? Only --list goes without")
    bench = bench_file.read_numbers(options.bench) if options.bench else None
    if (kind := no_port(options.port)) is not None:
        raise UserError(f"{options.port} is {kind}, not a serial port")
    port = Port(PortSettings(path=options.port, baud=options.baud))
    port.open()
    try:
        results = run(
            progress(cases, label="conformance", unit=" cases"), lambda: Host(port), bench, moving=options.moving
        )
    finally:
        port.close()
    table(results).show(options.json)
    return status(results)
