# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis diagnose RECORDING... --out DIR`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import nullcontext

from hydro_bridge.pages.runs import refresh_index
from hydro_core.cli.console import bounded_number, command, writable_folder
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError
from hydro_diagnosis.stage_bar import StageBar


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    options = argparse.ArgumentParser(
        prog="diagnose", description="Find, name and size the physics that a simulation leaves out."
    )
    options.add_argument(
        "recordings", nargs="*", metavar="RECORDING",
        help="rosbag2 folder or .mcap, or a file of another logger: " + ", ".join(RECORDING_SUFFIXES),
    )  # fmt: skip
    options.add_argument("--holdout", nargs="+", default=[], metavar="RECORDING", help="not fitted, checked on")
    options.add_argument(
        "--bench", metavar="FILE", help="bench.yaml or corrected.yaml, with what is known (default: nominal)"
    )
    options.add_argument(
        "--model", metavar="WEIGHTS",
        help="learned bench as the baseline in place of --bench: names what has changed since",
    )  # fmt: skip
    options.add_argument(
        "--columns", metavar="MAP", help="FIELD=COLUMN,... with units, scales, offsets and delays, for instance "
        "time=t,piston_position=pos[mm]-40,pressure_a=pa*1e5 or a YAML file of the same; `inspect FILE` proposes one",
    )  # fmt: skip
    options.add_argument(
        "--without", nargs="+", default=[], metavar="ID",
        help="causes that it cannot be, for instance backlash or friction_viscous:directional: they are not tried",
    )  # fmt: skip
    options.add_argument(
        "--estimate", nargs="+", default=[], metavar="NAME",
        help="numbers of the bench file that are not known, or only roughly: they are estimated from the recordings",
    )  # fmt: skip
    options.add_argument(
        "--as-wired", action="store_true", help="take the recordings as they are: try no repairs of wiring or units"
    )
    options.add_argument(
        "--simulated", nargs="+", default=[], metavar="SIM",
        help="recordings of your own simulator (Simulink, Gazebo, Modelica, ...) driven with the bench's commands: the "
        "report says what the bench has that the simulator has not, and by which numbers they differ",
    )  # fmt: skip
    options.add_argument("--simulated-columns", metavar="MAP", help="--columns of these (default: the same)")
    options.add_argument(
        "--seconds", type=bounded_number(0.1), metavar="S", help="budget of work, in s of CPU as counted, not timed "
        "(default: 24, in proportion beyond 60 s at 1 kHz)",
    )  # fmt: skip
    options.add_argument("--out", type=writable_folder, metavar="DIR", help="where the report goes")
    options.add_argument("--quiet", action="store_true", help="no progress")
    options.add_argument(
        "--page", action="store_true", help="in place of recordings: a page in the browser to drop them on"
    )
    options.add_argument("--port", type=int, default=0, metavar="N", help="of the page (default: a free one)")
    options.add_argument("--no-open", dest="open", action="store_false", help="open no browser")
    return options


def run(arguments: Sequence[str]) -> int:
    """Run the command; returns 0 for any verdict, 1 if a stage failed."""
    options = parser()
    chosen = options.parse_args(arguments)
    if bool(chosen.recordings) == chosen.page:
        options.error("give recordings or --page")
    if chosen.simulated_columns and not chosen.simulated:
        options.error("--simulated-columns goes with --simulated")
    if chosen.page:
        from hydro_diagnosis import import_page

        return import_page.run(chosen.bench, chosen.port, opened=chosen.open)
    if not chosen.out:
        options.error("--out DIR says where the report goes")
    if chosen.columns and not (chosen.bench or chosen.model):
        print(
            "note: without --bench FILE these recordings are compared with the nominal bench",
            file=sys.stderr,
        )
    from hydro_diagnosis.stage_border import TRACEBACKS, StageError

    try:
        with nullcontext(lambda text: None) if chosen.quiet else StageBar() as told:
            told("loading the program")
            from hydro_diagnosis.pipeline import diagnose
            from hydro_diagnosis.report.page import write_files

            found = diagnose(
                chosen.recordings, holdout=chosen.holdout, bench=chosen.bench, model=chosen.model,
                columns=chosen.columns, without=chosen.without, estimate=chosen.estimate, as_wired=chosen.as_wired,
                simulated=chosen.simulated, simulated_columns=chosen.simulated_columns, seconds=chosen.seconds,
                progress=told,
            )  # fmt: skip
    except StageError as error:
        error.border.write(chosen.out)
        print(f"{error}: there is no report ({chosen.out / TRACEBACKS})", file=sys.stderr)
        return 1
    write_files(found, chosen.out)
    refresh_index(chosen.out)
    print(found)
    print(f"{chosen.out / 'report.html'}, report.json, corrected.yaml ({found.report.seconds:.1f} s)")
    return 1 if found.report.lost else 0


@command(InputError, OSError)
def main() -> int:
    """Entry point; 1 if a stage failed, 2 for input that cannot be diagnosed, 130 when interrupted."""
    return run(sys.argv[1:])


if __name__ == "__main__":
    main()
