# SPDX-License-Identifier: Apache-2.0
"""Try over the line whether a box keeps the protocol: ros2 run hydro_bridge conformance --port PORT --bench FILE.

Without --moving nothing is sent that arms the box, and the piston rests. End the bridge first: the port is for one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from unittest.mock import patch

import pytest

from hydro_bridge.conformance.host import LATENCY, Host
from hydro_bridge.serial.port import Port, PortSettings
from hydro_core.cli.console import Table, add_json_argument, command, make_parser, progress
from hydro_core.errors import UserError
from hydro_core.files import bench_digest
from hydro_core.signals import Command, Flag

PASS, FAIL, LEFT_OUT, INCONCLUSIVE = "pass", "FAIL", "left out", "not judged"
COLUMNS = {
    "case": "what was tried",
    "result": "pass, FAIL, left out, or not judged: this host was late, or nothing was decided",
    "found": "why it did not pass, or what was not looked at",
    "says": "what must hold",
}
PYTEST = (
    "--pyargs hydro_bridge.conformance -o python_files=rules.py --assert=plain --noconftest -s "
    f"--rootdir=/ -c {os.devnull} -p no:terminal -p no:cacheprovider"
)
"""Words for pytest: the rules alone, whatever the folder where it runs says."""


class Run:
    """Plugin of pytest that opens a session with the box for each rule, and keeps a row of the table.

    `session`: opens one; `only`: beginnings of the names of cases.
    """

    def __init__(self, session: Callable[[], Host], only: Sequence[str] = ()) -> None:
        self.session, self.only, self.rows = session, tuple(only), list[dict[str, str]]()
        self.error: BaseException | None = None

    def start(self) -> list[dict[str, str]]:
        """Run the cases, and return their rows; raises SilenceError if the box is not heard at all."""
        self.session().receive(1)
        with patch.dict(os.environ, PYTEST_DISABLE_PLUGIN_AUTOLOAD="1"):
            status = pytest.main(PYTEST.split(), plugins=[self])
        if self.error or status > pytest.ExitCode.TESTS_FAILED:
            raise self.error or (KeyboardInterrupt() if status == pytest.ExitCode.INTERRUPTED else RuntimeError(status))
        return self.rows

    def pytest_collection_modifyitems(self, items: list[pytest.Function]) -> None:
        """Name the cases area.rule, and select some."""
        for item in items:
            item.name = item.callspec.id if hasattr(item, "callspec") else item.name[5:].replace("_", ".", 1)
        names = [item.name for item in items]
        if unknown := [each for each in self.only if not any(name.startswith(each) for name in names)]:
            self.error = UserError(f"--only: no case begins with {', '.join(unknown)}; there is {', '.join(names)}")
        items[:] = [] if unknown else [item for item in items if item.name.startswith(self.only or "")]
        self.bar = progress([None] * len(items), label="conformance", unit=" cases")

    @pytest.fixture
    def host(self) -> Iterator[Host]:
        """Yield a session with the box, which begins and ends disarmed; no case provokes the box's force limit."""
        self.now = session = self.session()
        session.open()
        yield session
        session.command = Command()
        session.receive(10 + LATENCY, times=1)
        if any(state.flags & Flag.TRIPPED and state.flags & Flag.FORCE_LIMIT for state in session.states):
            limit = f"its limit of {session.details.load_force_limit:g} N"
            pytest.fail(f"it tripped at {limit}: are sign and null of the valve right?")

    def pytest_runtest_makereport(self, item: pytest.Function, call: pytest.CallInfo[None]) -> None:
        """Keep the row of a case; what its last stage raised counts."""
        if call.when == "setup":
            says = item.callspec.params["says"] if hasattr(item, "callspec") else item.function.__doc__
            self.rows.append({"case": item.name, "result": PASS, "found": "", "says": str(says).rstrip(".")})
        self.bar.update(call.when == "teardown")
        if call.excinfo is not None:
            error = call.excinfo.value
            late = isinstance(error, AssertionError) and self.now.longest_read_gap > 0.015
            others = {pytest.skip.Exception: LEFT_OUT, pytest.xfail.Exception: INCONCLUSIVE}
            self.rows[-1] |= {"result": INCONCLUSIVE if late else others.get(type(error), FAIL), "found": str(error)}
            if not isinstance(error, (AssertionError, pytest.fail.Exception, *others)):
                self.error, item.session.shouldstop = error, True


@command()
def main() -> int:
    """Entry point; exit status 1 if a case failed, else 3 if one was not judged."""
    parser = make_parser("conformance", __doc__)
    parser.add_argument("--port", required=True, help="device of the box, or link to one")
    parser.add_argument("--baud", type=int, default=PortSettings().baud, help="bit/s; default: %(default)s")
    parser.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml of the box; absent: not tried")
    parser.add_argument("--moving", action="store_true", help="also arm the box: the piston moves (your_own_box.md)")
    parser.add_argument("--only", nargs="+", default=[], metavar="CASE", help="names, or their beginnings")
    add_json_argument(parser)
    options = parser.parse_args()
    bench = bench_digest.read_parameters(options.bench) if options.bench else None
    with closing(Port(PortSettings(path=options.port, baud=options.baud))) as port:
        port.open()
        rows = Run(partial(Host, port, bench=bench, moving=options.moving), options.only).start()
    found = [row["result"] for row in rows]
    title = ", ".join(f"{found.count(one)} {one}" for one in (PASS, FAIL, LEFT_OUT, INCONCLUSIVE))
    Table(COLUMNS, title, rows).show(options.json)
    return 1 if FAIL in found else 3 if INCONCLUSIVE in found else 0
