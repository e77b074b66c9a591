# SPDX-License-Identifier: Apache-2.0
"""Try over the line whether a box keeps the protocol: ros2 run hydro_bridge conformance --port PORT --bench FILE.

Without --moving nothing is sent that arms the box, and the piston rests. End the bridge first: the port is for one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import yaml

from hydro_bridge.conformance.checks import CHECKS, InconclusiveError, NotReportedError, ViolationError, state_value
from hydro_bridge.conformance.host import (
    READ_INTERVAL_MAX,
    STEP_HANDLERS,
    Host,
    NoFrameError,
    NoStateError,
    open_session,
)
from hydro_bridge.conformance.reference import force_gain
from hydro_bridge.serial.port import Port, PortSettings, describe_non_port
from hydro_core.cli.console import Table, add_json_argument, command, make_parser, progress
from hydro_core.errors import UserError
from hydro_core.files import bench_digest
from hydro_core.signals import Command, Flag

NOMINAL_FORCE_GAIN = 10.53e6
"""g of the nominal bench [N/s/A]: a correction of 0.2 mA moves the force there by up to g 0.2 mA / K_p, 140 N."""


class Case(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Test case for one requirement on a box."""

    id: str
    says: str
    """The requirement, as one sentence."""
    steps: tuple[dict[str, Any], ...]
    """Per step the name of its handler (`host.STEP_HANDLERS`), or `check`, and its parameters."""
    moving: bool = False
    """Whether the case arms the box, or requests arming: the piston may move."""
    needs: str = ""
    """Precondition, `bench`, `compensated law`, or both of these; empty: none."""

    def __post_init__(self) -> None:
        for step in self.steps:
            if len(step) != 1 or not step.keys() <= {*STEP_HANDLERS, "check"}:
                known = ", ".join(STEP_HANDLERS)
                raise UserError(f"conformance case {self.id!r}: a step is one of {known}, check, not {step}")
            (words,) = step.values()
            if not self.moving and isinstance(words, dict) and words.get("arm"):
                raise UserError(f"conformance case {self.id!r} asks the box to arm and is not marked as moving")


def shipped_cases() -> tuple[Case, ...]:
    """Return the cases shipped with this package."""
    text = resources.files("hydro_bridge.conformance").joinpath("cases.yaml").read_text(encoding="utf-8")
    return parse_cases(yaml.safe_load(text))


def parse_cases(content: Any) -> tuple[Case, ...]:
    """Parse the cases from a file's content.

    Raises UserError: a step is unknown, or a case that is not marked as moving asks a box to arm;
    msgspec.ValidationError: a case is incomplete.
    """
    return msgspec.convert(content, tuple[Case, ...])


PASS, FAIL, LEFT_OUT, INCONCLUSIVE = "pass", "FAIL", "left out", "not judged"


@dataclass(frozen=True)
class Result:
    """Result of a case."""

    case: Case
    outcome: str
    """`PASS`, `FAIL`, `LEFT_OUT` or `INCONCLUSIVE`."""
    reason: str
    """Reason for an outcome other than `PASS`, or aspects that were not examined."""


def run_cases(
    cases: Iterable[Case], make_host: Callable[[], Host], bench: Mapping[str, Any] | None, *, moving: bool
) -> list[Result]:
    """Run the cases in order and return their results; each begins and ends disarmed.

    Raises NoFrameError: no frame arrived before the first result.
    """
    results: list[Result] = []
    for case in cases:
        try:
            results.append(_run(case, make_host, bench, moving))
        except NoFrameError as error:
            if not results:
                raise
            results.append(Result(case, FAIL, str(error)))
    return results


def _run(case: Case, make_host: Callable[[], Host], bench: Mapping[str, Any] | None, moving: bool) -> Result:
    """Run a case; a failure while this host was late is repeated once, then counted as not judged."""
    if case.moving and not moving:
        return Result(case, LEFT_OUT, "may move the piston: --moving")
    if "bench" in case.needs and bench is None:
        return Result(case, LEFT_OUT, "needs the box's bench file: --bench")
    for _ in range(2):
        host = make_host()
        host.bench = bench or {}
        outcome, found = _converse(case, host)
        if outcome != FAIL or host.longest_read_gap <= READ_INTERVAL_MAX:
            return Result(case, outcome, found)
    return Result(case, INCONCLUSIVE, f"this host was silent for {1e3 * host.longest_read_gap:.0f} ms; {found}")


def _converse(case: Case, host: Host) -> tuple[str, str]:
    """Return outcome and finding of one session with the box."""
    checked: list[tuple[Host, dict[str, Any]]] = []
    silent = ""
    try:
        open_session(host)
        if host.bench:
            host.correction_scale = min(1.0, host.force_scale * NOMINAL_FORCE_GAIN / force_gain(host.bench))
        if "compensated law" in case.needs and host.law is None:
            return LEFT_OUT, "the box runs the paper's law only"
        for step in case.steps:
            ((verb, words),) = step.items()
            if verb == "check":
                checked.append((host.snapshot(), words))
            else:
                STEP_HANDLERS[verb](host, words)
        host.command = Command()  # disarmed
        host.receive(10, host.send)
    except NoStateError as error:
        silent = str(error)
    wanted, armed = Flag.TRIPPED | Flag.FORCE_LIMIT, 0
    for state in host.states if case.moving else ():  # no case provokes a trip by the force limit
        if state.flags & wanted == wanted:
            limit = f"beyond its limit of {host.details.load_force_limit:g} N, {armed} samples after it was armed"
            force = f"{state_value(state, 'load_force'):.0f} N"
            hint = "are sign and null of the valve right?"
            return FAIL, f"it tripped at {force}, {limit}: the rest was not tried; {hint}"
        armed += bool(state.flags & Flag.ARMED)
    try:  # only now: while this host computes, the box would receive no command
        for seen, words in checked:
            for name, parameters in words.items():
                CHECKS[name](seen, **(parameters or {}))
    except ViolationError as wrong:
        return FAIL, f"{name}: {wrong}"
    except NotReportedError as missing:
        return LEFT_OUT, str(missing)
    except InconclusiveError as undecided:
        return INCONCLUSIVE, str(undecided)
    notes = [note for seen, _ in checked for note in seen.notes]
    return (FAIL, silent) if silent else (PASS, "; ".join(notes))


_INCONCLUSIVE_STATUS = 3
"""Exit status where nothing failed and something was not judged; 2 is that of a wrong command line."""

COLUMNS = {
    "case": "what was tried",
    "result": "pass, FAIL, left out, or not judged: this host was late twice, or nothing was decided",
    "found": "why it did not pass, or what was not looked at",
    "says": "what must hold",
}


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    parser = make_parser("conformance", __doc__)
    parser.add_argument("--port", help="device of the box, or link to one")
    parser.add_argument("--baud", type=int, default=PortSettings().baud, help="bit/s; default: %(default)s")
    parser.add_argument(
        "--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; absent: not tried"
    )
    parser.add_argument(
        "--moving", action="store_true", help="also what arms the box: the piston moves, how far says your_own_box.md"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="CASE", help="ids, or their beginnings")
    parser.add_argument("--list", action="store_true", dest="listed", help="show the cases and end")
    add_json_argument(parser)
    return parser


def select_cases(cases: tuple[Case, ...], beginnings: list[str]) -> tuple[Case, ...]:
    """Return the cases whose id begins with one of `beginnings`; all if it is empty.

    Raises UserError: no case begins with one of them.
    """
    for each in beginnings:
        if not any(case.id.startswith(each) for case in cases):
            raise UserError(f"--only {each}: no case begins so; --list shows them")
    return tuple(case for case in cases if not beginnings or case.id.startswith(tuple(beginnings)))


@command()
def main() -> int:
    """Entry point; exit status 1 if a case failed, else 3 if this host was too late to judge one."""
    options = parser().parse_args()
    cases = select_cases(shipped_cases(), options.only)
    if options.listed:
        listing = Table({"case": "", "moving": "", "needs": "", "says": ""})
        for case in cases:
            listing.add(case=case.id, moving="moving" if case.moving else "", needs=case.needs, says=case.says)
        listing.show(options.json)
        return 0
    if options.port is None:
        raise UserError("--port: which device is the box at? Only --list goes without")
    bench = bench_digest.read_parameters(options.bench) if options.bench else None
    if (kind := describe_non_port(options.port)) is not None:
        raise UserError(f"{options.port} is {kind}, not a serial port")
    port = Port(PortSettings(path=options.port, baud=options.baud))
    port.open()
    try:
        results = run_cases(
            progress(cases, label="conformance", unit=" cases"), lambda: Host(port), bench, moving=options.moving
        )
    finally:
        port.close()
    found = [result.outcome for result in results]
    table = Table(COLUMNS, title=", ".join(f"{found.count(one)} {one}" for one in (PASS, FAIL, LEFT_OUT, INCONCLUSIVE)))
    for result in results:
        table.add(case=result.case.id, result=result.outcome, found=result.reason, says=result.case.says)
    table.show(options.json)
    return 1 if FAIL in found else _INCONCLUSIVE_STATUS if INCONCLUSIVE in found else 0
