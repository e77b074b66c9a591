# SPDX-License-Identifier: Apache-2.0
"""Writes the front page of a folder of runs: what each was, its pictures and pages. Opens it, too.

ros2 run hydro_bridge runs                 # runs/index.html
ros2 run hydro_bridge runs archive --json archive.json
"""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from hydro_bridge.cli.console import Table, UserError, add_json_argument, command
from hydro_bridge.viewer.runs import FOLDER, list_runs, write_index

COLUMNS = {"run": "folder", "kind": "what it was", "changed": "", "summary": ""}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="runs", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    result.add_argument("folder", nargs="?", type=Path, default=Path(FOLDER), help=f"of runs (default {FOLDER})")
    result.add_argument("--no-open", dest="open", action="store_false", help="open no browser")
    add_json_argument(result)
    return result


@command()
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    if not options.folder.is_dir():
        raise UserError(f"{options.folder} is no folder: name one that holds runs")
    index = write_index(options.folder)
    table = Table(COLUMNS, title=str(index))
    for run in list_runs(options.folder):
        table.add(run=run.name, kind=run.kind, changed=run.when, summary=run.summary)
    table.show(options.json)
    if options.open:
        webbrowser.open(index.absolute().as_uri())
