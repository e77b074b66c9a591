# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis diagnose --grow REPORT... --id NAME`: a use of `diagnose` with options of its own."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_bridge.cli.console import Table, UserError, writable, writable_folder

if TYPE_CHECKING:
    from hydro_diagnosis.growing.sightings import Sighting

FLAG = "--grow"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    options = argparse.ArgumentParser(
        prog="diagnose",
        usage="diagnose --grow REPORT... --id NAME [--law FORM] [--out FOLDER] [--json FILE]",
        description="A law that was found on several benches becomes a named effect.",
    )
    add_options(options, required=True)
    options.add_argument("--out", type=writable_folder, metavar="FOLDER", help="where its file goes (default: the "
                         "source tree in a checkout, else ~/.local/share/hydro/effects)")  # fmt: skip
    return options


def add_options(options: argparse.ArgumentParser | argparse._ArgumentGroup, *, required: bool) -> None:
    """Add the options of `--grow`; `diagnose` lists them in its own help, where none is required."""
    options.add_argument(FLAG, nargs="+", required=required, metavar="REPORT", dest="reports",
                         help="report.json of two benches or more, or the folders that hold them: the law that they "
                         "share becomes a named effect")  # fmt: skip
    options.add_argument("--id", required=required, metavar="NAME", help="of the effect, for instance port_drag")
    options.add_argument("--law", metavar="FORM", help="which one, where the reports have several laws in common")
    options.add_argument("--json", type=writable, metavar="FILE", help="also write the table of the law's numbers")


def run(arguments: Sequence[str]) -> int:
    """Compare the reports, write the effect, say what was found."""
    chosen = parser().parse_args(arguments)
    from hydro_diagnosis.growing.sightings import agreements, sightings, written
    from hydro_sim.model.effects import grown

    folder = chosen.out or grown.folder()
    path = folder / f"{chosen.id}.yaml"
    _refuse_id(chosen.id, path)
    found = sightings(chosen.reports, chosen.law)
    agreed = agreements(found)
    written(found, agreed, path)
    law = found[0].law
    side_by_side(found).show(chosen.json)
    print(f"\n{chosen.id}: {law.sentence}")
    for one in agreed:
        print(f"  {one.sentence}")
    print(f"{path} is the effect")
    if not grown.is_read(folder):
        print(f"bench files may name it where {grown.VARIABLE}={folder} is set")
    return 0


def side_by_side(found: Sequence[Sighting]) -> Table:
    """The law's numbers, one row for each bench and number."""
    from hydro_diagnosis.growing.sightings import units

    law = found[0].law
    made = Table(
        {"report": "", "parameter": "", "value": "SI, in the unit beside it", "low": "of the 95 % interval", "high": "",
         "unit": ""},
        title=f"{law.form} ({law.equation}): {law.text}",
    )  # fmt: skip
    for name, unit in units(law).items():
        for one in found:
            estimate = one.estimates[name]
            low, high = estimate.ci95 or (float("nan"), float("nan"))
            made.add(report=one.report, parameter=name, value=estimate.value, low=low, high=high, unit=unit)
    return made


def _refuse_id(name: str, path: Path) -> None:
    """Refuse an id that is no name, or is taken."""
    from hydro_diagnosis.effects import CANDIDATES
    from hydro_sim.model.effects.catalogue import KINDS

    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name):
        raise UserError(f"--id {name!r}: use lower-case words joined by _, for instance port_drag")
    taken = {one.split()[0] for one in KINDS} | {one.id for one in CANDIDATES}
    if name in taken:
        raise UserError(f"--id {name}: an effect of this id exists: choose another name")
    if path.exists():
        raise UserError(f"{path} exists: choose another --id")
