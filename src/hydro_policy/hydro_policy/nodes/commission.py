# SPDX-License-Identifier: Apache-2.0
"""Commissions a bench: from the cable to a compared controller behind a filter of this bench, gate by gate.

ros2 run hydro_policy commission --port /dev/ttyUSB0 --bench own.yaml --site own
ros2 run hydro_policy commission --plant emulator --site emulated
ros2 run hydro_policy commission --site own                       # goes on at the first gate that has not passed
ros2 run hydro_policy commission --site own --again               # after a change of spring, supply, oil or valve
"""

from __future__ import annotations

import argparse
import shutil
import time
from contextlib import ExitStack
from pathlib import Path

from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.ros.node import running_ros
from hydro_bridge.safety.readiness import NotReadyError
from hydro_core.cli.console import UserError, command, make_parser, writable_folder
from hydro_core.files import bench_file, site
from hydro_policy.commissioning.record import FAILED, PASSED, SKIPPED, GateError, GateSkipped, Record, digests
from hydro_policy.nodes.commissioning import GATES, NAMES, Gate
from hydro_policy.nodes.site_runs import EMULATED, TRUTH, Site
from hydro_sim.files.pairing import PairingError

AGAIN = "gains"
"""Gate from which `--again` repeats: a bench that has changed moves by half of the amplitude first."""
LOG = "commission.log"


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = make_parser("commission", __doc__)
    result.add_argument("--site", required=True, type=writable_folder, metavar="DIR", help="folder of this bench")
    plant = result.add_mutually_exclusive_group()
    plant.add_argument("--port", metavar="PATH", help="serial port of the box; a site keeps it")
    plant.add_argument("--plant", choices=(EMULATED,), help="commission an emulated bench in its place")
    result.add_argument("--bench", type=Path, metavar="FILE", help="bench.yaml that the box believes; a site keeps it")
    result.add_argument(
        "--truth", type=Path, metavar="FILE", help="YAML of what the emulated bench is made of; a site keeps it"
    )
    result.add_argument(
        "--arm",
        choices=("person", "auto"),
        help="who arms before each motion: a person, by Enter or `arm` (default on a port), or nobody is asked "
        "(default with the emulator)",
    )
    result.add_argument(
        "--amplitude", type=float, metavar="N",
        help="of the sines; default: 9.4 %% of piston area times supply pressure",
    )  # fmt: skip
    result.add_argument("--policy", action="store_true", help="pretrain a policy in simulation, and compare it, too")
    repeat = result.add_mutually_exclusive_group()
    repeat.add_argument("--from", dest="start", choices=NAMES, metavar="GATE", help=f"repeat from: {', '.join(NAMES)}")
    repeat.add_argument("--again", action="store_true", help=f"the bench has changed: repeat from {AGAIN}")
    return result


@command(CompanionError, ValueError)
def main() -> int:
    """Entry point; status 0 where all gates passed, 1 where one failed."""
    options = parser().parse_args()
    folder: Path = options.site
    record = Record.load(folder, NAMES)
    changed = _take(options, folder, record)
    untrained = options.policy and record.gates[NAMES.index("policy")].status != PASSED
    start = AGAIN if options.again else options.start or ("policy" if untrained else None)
    starts = [name for name in (start, "signs" if changed else None) if name]
    first = record.hold(folder, min((NAMES.index(name) for name in starts), default=len(GATES)))
    for gate in GATES[:first]:
        print(f"{gate.name}: passed before")
    with ExitStack() as stack:
        log = stack.enter_context((folder / LOG).open("a", buffering=1, encoding="utf-8"))
        stack.enter_context(running_ros())
        rearm = options.arm == "auto" if options.arm else record.plant == EMULATED
        at = stack.enter_context(Site(folder, record, rearm=rearm, policy=options.policy, log=log))
        passed = all(_pass(at, gate) for gate in GATES[first:])
    print(f"\n{record.table().text()}\n")
    if record.comparison:
        print(f"{record.compared().text()}\n")
    print(f"page: {folder / 'report.html'}")
    return 0 if passed and record.complete else 1


def _take(options: argparse.Namespace, folder: Path, record: Record) -> bool:
    """Put plant and bench file into the site, or refuse others than it has; whether the amplitude is another."""
    plant = options.plant or options.port or record.plant
    if not plant:
        raise UserError("which bench? Name its --port, or --plant emulator")
    if EMULATED in (record.plant, plant) and record.plant not in ("", plant):
        raise UserError(f"{folder} is the site of {record.plant}, not of {plant}: name another --site")
    if options.truth and plant != EMULATED:
        raise UserError("--truth is of the emulated bench: it goes with --plant emulator")
    own = folder / site.BENCH
    given = options.bench or (bench_file.shipped_bench_file() if plant == EMULATED else None)
    if own.is_file():
        if options.bench and bench_file.digest(bench_file.read_numbers(options.bench)) != bench_file.digest(
            bench_file.read_numbers(own)
        ):
            raise UserError(f"{own} is another bench than {options.bench}: name another --site")
    elif given is None:
        raise UserError("--bench: which bench.yaml does the box believe?")
    else:
        bench_file.read_numbers(given)
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(given, own)
    if options.truth:
        if not options.truth.is_file():
            raise UserError(f"--truth {options.truth}: there is no such file")
        shutil.copyfile(options.truth, folder / TRUTH)
    (folder / site.REPORTS).mkdir(exist_ok=True)
    before, record.plant, record.amplitude = record.amplitude, plant, options.amplitude or record.amplitude
    return record.amplitude != before


def _pass(at: Site, gate: Gate) -> bool:
    """Run a gate and record it; False where it failed."""
    result = next(entry for entry in at.record.gates if entry.name == gate.name)
    print(f"\n== {gate.name}")
    began = time.monotonic()
    try:
        result.reason, result.status = gate.run(at), PASSED
    except GateSkipped as skipped:
        result.reason, result.status = str(skipped), SKIPPED
    except (GateError, NotReadyError, CompanionError, PairingError) as error:
        result.reason, result.status = str(error), FAILED
    result.seconds = round(time.monotonic() - began, 1)
    result.files = digests(at.folder, gate.files)
    at.record.write(at.folder)
    print(f"{gate.name}: {result.status}: {result.reason} ({result.seconds:.0f} s)")
    return result.status != FAILED
