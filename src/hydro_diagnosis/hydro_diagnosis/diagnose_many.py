# SPDX-License-Identifier: Apache-2.0
"""Diagnoses each of many recordings by itself; the results become one table, as a page and as CSV.

ros2 run hydro_diagnosis diagnose_many runs --bench mine.yaml --out study        # all recordings in a folder
ros2 run hydro_diagnosis diagnose_many 'today/*.mf4' --columns map.yaml --bench mine.yaml --out study
ros2 run hydro_diagnosis diagnose_many @list.txt --out study                     # one path a line

The same command continues where it was interrupted.
"""

from __future__ import annotations

import argparse
import csv
import glob
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from hashlib import sha256
from io import StringIO
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hydro_bridge.bags import exists
from hydro_bridge.pages import environment
from hydro_core.cli.console import UserError, command, plural, writable_folder
from hydro_core.files.atomic import write_atomic
from hydro_core.settings import read_yaml
from hydro_diagnosis import jobs
from hydro_diagnosis.bench_parameters import read_bench
from hydro_diagnosis.effects.base import display_unit
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError
from hydro_diagnosis.report_json import row_of

COLUMNS = ("recording", "begin", "verdict", "refused", "explained", "closures", "cause", "options", "parameter",
           "value", "low", "high", "unit")  # fmt: skip
"""Columns of diagnoses.csv (`many_recordings.md`)."""


def find_recordings(words: Sequence[str]) -> dict[str, Path]:
    """Recordings by name, in order: files, bags, and those of folders or glob patterns.

    Raises UserError if a word gives no recording.
    """
    found: dict[Path, None] = {}
    for word in words:
        paths = sorted(map(Path, glob.glob(word, recursive=True))) if glob.has_magic(word) else [Path(word)]
        there = [one.resolve() for path in paths if exists(path) for one in _within(path)]
        if not there:
            raise UserError(f"{word}: there is no recording")
        found.update(dict.fromkeys(there))
    top = Path(os.path.commonpath([path.parent for path in found]))
    return {path.relative_to(top).as_posix(): path for path in found}


def _within(path: Path) -> Iterator[Path]:
    if not path.is_dir() or (path / "metadata.yaml").is_file():  # a file, or a bag
        yield path
        return
    for one in sorted(path.iterdir()):
        if one.is_dir() or one.suffix.lower() in (".mcap", *RECORDING_SUFFIXES):
            yield from _within(one)


def report_folder(name: str) -> str:
    """Folder of a recording's report, below that of the study."""
    return f"reports/{name.replace('#t=', '/')}"


def diagnose_one(path: str, folder: str, options: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Diagnose one recording, write its report to a folder, and return its rows of the table, without its name."""
    from hydro_diagnosis.pipeline import diagnose
    from hydro_diagnosis.report.page import write_files

    try:
        found = diagnose([path], **options)
    except InputError as error:
        return [{"refused": str(error)}]
    write_files(found, Path(folder))
    report = found.report
    begin = report.recordings[0]["begin"]
    about = {
        "begin": None if begin is None else datetime.fromtimestamp(begin, timezone.utc).isoformat(),
        "verdict": report.verdict,
        "explained": min((one["all"] for one in report.accounted.values()), default=None),
        "closures": len(report.closures),
    }
    if report.lost:
        about["refused"] = "; ".join(one.sentence for one in report.lost)
    rows = [
        {"cause": effect.id, "options": ",".join(f"{key}={one}" for key, one in effect.options.items()),
         "parameter": name, **row_of(estimate)}
        for effect in report.effects
        for name, estimate in effect.parameters.items()
    ]  # fmt: skip
    rows += [{"parameter": one.name, **row_of(one)} for one in report.estimated]
    return [{**about, **row} for row in rows or [{}]]


def write_table(folder: Path, found: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write diagnoses.csv and diagnoses.html; `found`: rows by recording, as of `diagnose_one`."""
    text = StringIO(newline="")
    table = csv.DictWriter(text, COLUMNS, restval="")
    table.writeheader()
    table.writerows({"recording": name, **row} for name, rows in found.items() for row in rows)
    write_atomic(folder / "diagnoses.csv", text.getvalue().encode())
    made = environment("hydro_diagnosis", "report/templates")
    made.filters.update(display_unit=display_unit, report=lambda name: quote(f"{report_folder(name)}/report.html"))
    page = made.get_template("diagnoses.html").render(title="Diagnoses", found=found)
    write_atomic(folder / "diagnoses.html", page.encode())


def parser() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    options = argparse.ArgumentParser(
        prog="diagnose_many", description=__doc__, formatter_class=argparse.RawTextHelpFormatter,
        fromfile_prefix_chars="@",
    )  # fmt: skip
    options.add_argument(
        "recordings", nargs="+", metavar="RECORDING",
        help="as for diagnose; a folder of recordings, a pattern, or @FILE with one of them a line",
    )  # fmt: skip
    options.add_argument("--bench", metavar="FILE", help="as for diagnose, of all recordings")
    options.add_argument("--columns", metavar="MAP", help="as for diagnose, of all recordings")
    options.add_argument("--without", nargs="+", default=[], metavar="ID", help="as for diagnose")
    options.add_argument("--estimate", nargs="+", default=[], metavar="NAME", help="as for diagnose")
    options.add_argument("--seconds", type=float, metavar="S", help="as for diagnose, for each recording")
    options.add_argument("--out", required=True, type=writable_folder, metavar="STUDY", help="folder of the results")
    jobs.add_arguments(options)
    return options


@command(InputError, ValueError, OSError)
def main() -> int:
    """Entry point; 0 if each recording was diagnosed or refused in a sentence, 2 if one could not be."""
    chosen = parser().parse_args(sys.argv[1:])
    named = find_recordings(chosen.recordings)
    if chosen.bench:
        read_bench(chosen.bench, frozenset(chosen.estimate))  # refuses what cannot be read
    columns = ColumnMap.load(chosen.columns)
    options = {  # with the content of files in place of their paths: what is done depends on it
        "bench": read_yaml(chosen.bench) if chosen.bench else None,
        "columns": None if columns is None else str(columns),
        **{name: getattr(chosen, name) for name in ("without", "estimate", "seconds")},
    }
    chosen.out.mkdir(parents=True, exist_ok=True)
    arguments = {name: (str(path), str(chosen.out / report_folder(name)), options) for name, path in named.items()}
    digest = sha256(json.dumps(options, sort_keys=True).encode()).hexdigest()[:12]
    results = chosen.out / f"found-{digest}.jsonl"
    found: dict[str, list[dict[str, Any]]] = {}
    try:
        found.update(
            jobs.run(diagnose_one, arguments, results_file=results, label="diagnoses", unit="recording",
                     **jobs.job_options(chosen))
        )  # fmt: skip
    finally:
        write_table(chosen.out, {name: found[name] for name in named if name in found})
    refused = {name: rows[0]["refused"] for name, rows in found.items() if "refused" in rows[0]}
    for name, why in refused.items():
        print(f"{name}: refused: {why}", file=sys.stderr)
    print(f"{chosen.out}/diagnoses.html, diagnoses.csv: {plural(len(found), 'recording')}, {len(refused)} refused")
    return 0
