# SPDX-License-Identifier: Apache-2.0
"""A site: the folder of one bench, written by `commission`. Names of its files.

bench.yaml              what the box believes
corrected.yaml          what the bench is, as far as a diagnosis found
metric.safetensors      the filter's metric of it
recordings/, reports/   by gate
commission.json         which gates passed, causes, comparison; report.html beside it
"""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path

from hydro_core.errors import UserError

BENCH, MODEL, METRIC = "bench.yaml", "corrected.yaml", "metric.safetensors"
RECORDINGS, REPORTS, RECORD = "recordings", "reports", "commission.json"

RECOMMISSION_HINT = (
    "after a change of spring, supply, oil or valve `ros2 run hydro_policy commission --again --site DIR` makes model "
    "and metric of the bench as it is"
)
"""What to do where a filter's model is not this bench's."""


def add_site_option(parser: argparse._ActionsContainer, taken: str) -> None:
    """Add the option --site; `taken` names the options it replaces, for the help text."""
    parser.add_argument("--site", type=Path, metavar="DIR", help=f"folder of `commission`, in place of {taken}")


def base_gains(folder: Path) -> list[float] | None:
    """Return the base gains K_p [1/s] and K_i [1/s^2] that the box of a site reported; None: not known yet."""
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))["base_gains"]
        return [float(value) for value in found] or None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def apply_site_option(options: argparse.Namespace, **files: str) -> None:
    """Fill in options with files of the site's folder, if --site is given.

    `options`: parsed options; `site` may be None. `files`: name of the file by option; or words for a command line, in
    which such names are replaced. Raises UserError: the folder is no site, or one of the options was given, too.
    """
    if options.site is None:
        return
    folder: Path = options.site.absolute()
    for option, words in files.items():
        if getattr(options, option):
            raise UserError(f"--{option} is told by --site {options.site}: leave one of them out")
        found = [str(folder / name) if name in (BENCH, MODEL, METRIC) else name for name in words.split()]
        for path in map(Path, found):
            if path.is_absolute() and not path.is_file():
                raise UserError(f"{path} is not there: `ros2 run hydro_policy commission` has not got that far")
        setattr(options, option, shlex.join(found) if len(found) > 1 else Path(found[0]))
