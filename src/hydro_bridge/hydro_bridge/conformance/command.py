# SPDX-License-Identifier: Apache-2.0
"""Try over the line whether a box keeps the protocol: ros2 run hydro_bridge conformance --port PORT --bench FILE.

Without --moving nothing is sent that arms the box, and the piston rests. End the bridge first: the port is for one.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from tqdm import tqdm

from hydro_bridge.conformance.host import Host, SilenceError
from hydro_bridge.serial.port import Port, PortSettings, describe_non_port
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.cli.console import Table, add_json_argument, command, make_parser, progress
from hydro_core.errors import UserError
from hydro_core.files import bench_digest
from hydro_core.signals import Flag

PASS, FAIL, LEFT_OUT, INCONCLUSIVE = "pass", "FAIL", "left out", "not judged"
COLUMNS = {
    "case": "what was tried",
    "result": "pass, FAIL, left out, or not judged: this host was late twice, or nothing was decided",
    "found": "why it did not pass, or what was not looked at",
    "says": "what must hold",
}
PYTEST = (
    "--pyargs hydro_bridge.conformance -o python_files=rules.py -o python_classes=[AM]* --assert=plain --noconftest -s "
    f"--rootdir=/ -c {os.devnull} -p no:terminal -p no:cacheprovider"
)
"""Words for pytest: the rules alone, whatever the folder where it runs says."""


class Run:
    """Plugin of pytest that gives the rules a session with the box, and keeps a row of the table for each case.

    `line`, `clock`: see Host; `bench`: what the box's law believes, if known; `moving`: whether the box may be armed;
    `only`: beginnings of the names of cases.
    """

    def __init__(
        self, line: Port, clock: Callable[[], float] = time.monotonic, bench: Mapping[str, Any] | None = None,
        moving: bool = False, only: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.line, self.clock, self.numbers, self.moving, self.only = line, clock, bench, moving, tuple(only) or ("",)
        self.items: list[pytest.Function] = []
        self.rows: dict[str, dict[str, str]] = {}
        self.late: list[str] = []
        """Cases that failed while this host read the line at an interval of more than 15 ms."""
        self.error: BaseException | None = None
        """What the present case raised, or what ended the run."""

    def start(self, *options: str) -> list[dict[str, str]]:
        """Run the cases, and late ones once more; return the rows.

        Raises SilenceError: no box was heard before the first row.
        """
        for _ in range(2):
            self.late = []
            with patch.dict(os.environ, PYTEST_DISABLE_PLUGIN_AUTOLOAD="1"):
                status = pytest.main([*PYTEST.split(), *options], plugins=[self])
            if self.error is not None:
                raise self.error
            if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
                raise RuntimeError(f"pytest ended with {status!r}")
            if not self.late:
                break
            self.only = tuple(self.late)
        for case in self.late:
            self.rows[case]["result"] = INCONCLUSIVE
        return [*self.rows.values()]

    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Function]) -> None:
        """Select the cases."""
        for each in self.only:
            if not any(name_of(item).startswith(each) for item in items):
                self.error = UserError(f"--only {each}: no case begins so; --list shows them")
        items[:] = [] if self.error else [item for item in items if name_of(item).startswith(self.only)]
        self.items = list(items)
        if not config.option.collectonly:
            self.bar: tqdm[Any] = progress(total=len(items), label="conformance", unit=" cases")

    @pytest.fixture
    def host(self, request: pytest.FixtureRequest) -> Iterator[Host]:
        """Yield a session with the box, which begins and ends disarmed."""
        if request.cls.__name__ == "Moving" and not self.moving:
            pytest.skip("may move the piston: --moving")
        self.session = Host(self.line, self.clock, self.numbers)
        self.session.open()
        yield self.session
        self.session.close()

    @pytest.fixture
    def bench(self) -> Mapping[str, Any]:
        """Return the bench file's numbers."""
        return self.numbers or pytest.skip("needs the box's bench file: --bench")

    @pytest.fixture
    def law(self, host: Host) -> BoxLaw:
        """Return the box's compensated law."""
        return host.law or pytest.skip("the box runs the paper's law only")

    def pytest_runtest_makereport(self, item: pytest.Function, call: pytest.CallInfo[None]) -> None:
        """Keep the row of a case that has ended."""
        self.error = self.error or (call.excinfo.value if call.excinfo else None)
        if call.when != "teardown":
            return
        error, self.error, case = self.error, None, name_of(item)
        skipped, undecided = (isinstance(error, kind.Exception) for kind in (pytest.skip, pytest.xfail))
        outcome = LEFT_OUT if skipped else INCONCLUSIVE if undecided else FAIL if error else PASS
        found = str(error or "; ".join(self.session.notes))
        if outcome == FAIL:
            known = (AssertionError, SilenceError) if self.rows else AssertionError
            if not isinstance(error, known):
                self.error, item.session.shouldstop = error, True
            if self.session.longest_read_gap > 0.015:
                self.late.append(case)
        for state in self.session.states if outcome != LEFT_OUT else ():  # no case provokes this
            if state.flags & Flag.TRIPPED and state.flags & Flag.FORCE_LIMIT:
                limit = f"{state.values[2]:.0f} N, beyond its limit of {self.session.details.load_force_limit:g} N"
                outcome, found = FAIL, f"it tripped at {limit}: are sign and null of the valve right?"
                break
        self.rows[case] = {"case": case, "result": outcome, "found": found, "says": says(item)}
        self.bar.update()

    def pytest_keyboard_interrupt(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        """Keep an interruption, which ends the command, unless it is the stop for an earlier error."""
        self.error = self.error or excinfo.value


def name_of(item: pytest.Function) -> str:
    """Return a case's name, area.rule."""
    parameter = f"_{item.callspec.id}" if hasattr(item, "callspec") else ""
    return (item.originalname.removeprefix("test_") + parameter).replace("_", ".", 1)


def says(item: pytest.Function) -> str:
    """Return the sentence of a case's rule."""
    return str(item.function.__doc__).rstrip(".")


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    parser = make_parser("conformance", __doc__)
    parser.add_argument("--port", help="device of the box, or link to one")
    parser.add_argument("--baud", type=int, default=PortSettings().baud, help="bit/s; default: %(default)s")
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml of the box; absent: not tried")
    parser.add_argument("--moving", action="store_true", help="also arm the box: the piston moves (your_own_box.md)")
    parser.add_argument("--only", nargs="+", default=[], metavar="CASE", help="names, or their beginnings")
    parser.add_argument("--list", action="store_true", dest="listed", help="show the cases and end")
    add_json_argument(parser)
    return parser


@command()
def main() -> int:
    """Entry point; exit status 1 if a case failed, else 3 if one was not judged."""
    options = parser().parse_args()
    bench = bench_digest.read_parameters(options.bench) if options.bench else None
    port = Port(PortSettings(path=options.port or "", baud=options.baud))
    run = Run(port, bench=bench, moving=options.moving, only=options.only)
    if options.listed:
        run.start("--collect-only")
        listing = Table({"case": "", "moving": "", "needs": "", "says": ""})
        for item in run.items:
            needed = {"bench": "bench", "law": "compensated law"}
            needs = ", ".join(name for fixture, name in needed.items() if fixture in item.fixturenames)
            moving = "moving" if item.cls.__name__ == "Moving" else ""
            listing.add(case=name_of(item), moving=moving, needs=needs, says=says(item))
        listing.show(options.json)
        return 0
    if options.port is None:
        raise UserError("--port: which device is the box at? Only --list goes without")
    if (kind := describe_non_port(options.port)) is not None:
        raise UserError(f"{options.port} is {kind}, not a serial port")
    port.open()
    try:
        rows = run.start()
    finally:
        port.close()
    found = [row["result"] for row in rows]
    table = Table(COLUMNS, title=", ".join(f"{found.count(one)} {one}" for one in (PASS, FAIL, LEFT_OUT, INCONCLUSIVE)))
    for row in rows:
        table.add(**row)
    table.show(options.json)
    return 1 if FAIL in found else 3 if INCONCLUSIVE in found else 0
