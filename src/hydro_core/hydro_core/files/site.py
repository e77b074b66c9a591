# SPDX-License-Identifier: Apache-2.0
"""File names of a site, the folder of one bench that `commission` writes.

bench.yaml              bench model in the box's force law
corrected.yaml          bench model with the causes that a diagnosis identified
metric.safetensors      the filter's contraction metric for this model
recordings/, reports/   recordings and reports of each gate
commission.json         passed gates, causes, comparison; report.html in the same folder
"""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path

from hydro_core.errors import UserError

BENCH_FILE, MODEL_FILE, METRIC_FILE = "bench.yaml", "corrected.yaml", "metric.safetensors"
RECORDINGS_FOLDER, REPORTS_FOLDER, RECORD_FILE = "recordings", "reports", "commission.json"

RECOMMISSION_HINT = "make model and metric anew: `ros2 run hydro_policy commission --again --site DIR`"
"""Remedy for a filter whose model is not that of this bench."""


def add_site_option(parser: argparse._ActionsContainer, taken: str) -> None:
    """Add the option --site; `taken` names the options it replaces, for the help text."""
    parser.add_argument("--site", type=Path, metavar="DIR", help=f"folder of `commission`, in place of {taken}")


def base_gains(folder: Path) -> list[float] | None:
    """Return the base gains K_p [1/s] and K_i [1/s^2] that the box of a site reported; None: not known yet."""
    try:
        found = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))["base_gains"]
        return [float(value) for value in found] or None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def apply_site_option(options: argparse.Namespace, **files: str) -> None:
    """Fill in options with files in the site's folder, if --site is given.

    `options`: parsed options; `site` may be None. `files`: file name by option, or words of a command line, in which
    file names are replaced by paths. Raises UserError: the folder is no site, or one of the options was given, too.
    """
    if options.site is None:
        return
    folder: Path = options.site.absolute()
    for option, words in files.items():
        if getattr(options, option):
            raise UserError(f"--{option} is told by --site {options.site}: leave one of them out")
        found = [word if word.startswith("--") else str(folder / word) for word in words.split()]
        for path in found:
            if not path.startswith("--") and not Path(path).is_file():
                raise UserError(f"{path} is not there: `ros2 run hydro_policy commission` has not got that far")
        setattr(options, option, shlex.join(found) if len(found) > 1 else Path(found[0]))
