# SPDX-License-Identifier: Apache-2.0
"""Diagnoses each of many recordings by itself; what is found goes into tables in Parquet.

ros2 run hydro_diagnosis diagnose_many runs --bench mine.yaml --out study        # all recordings in a folder
ros2 run hydro_diagnosis diagnose_many 'today/*.mf4' --columns map.yaml --bench mine.yaml --out study
ros2 run hydro_diagnosis diagnose_many @list.txt --out study                     # one path a line
ros2 run hydro_diagnosis diagnose_many s3://lab/day.mcap --every 3600 --out study  # hour by hour

The same command does only what is missing.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet

from hydro_bridge.bags.location import exists, is_bag, is_remote, list_remote_bags, split_location
from hydro_bridge.bags.storage import BagSource
from hydro_bridge.bags.types import RecordingError
from hydro_core.cli import jobs
from hydro_core.cli.console import UserError, bounded_number, command, plural, writable_folder
from hydro_core.settings import read_yaml
from hydro_diagnosis.bench_parameters import read_bench
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError
from hydro_diagnosis.report_json import row_of

_KEY_FIELDS = [pa.field("recording", pa.string(), nullable=False), pa.field("begin", pa.timestamp("us", "UTC"))]
_TEXT, _TEXTS, _NUMBER = pa.string(), pa.list_(pa.string()), pa.float64()
DIAGNOSES_SCHEMA = pa.schema([
    *_KEY_FIELDS, ("verdict", _TEXT), ("refused", _TEXT), ("causes", _TEXTS), ("closures", pa.int32()),
    ("explained", _NUMBER), ("notes", _TEXTS), ("seconds", _NUMBER),
])  # fmt: skip
PARAMETERS_SCHEMA = pa.schema([
    *_KEY_FIELDS, ("cause", _TEXT), ("options", _TEXT), ("parameter", _TEXT), ("value", _NUMBER), ("low", _NUMBER),
    ("high", _NUMBER), ("unit", _TEXT),
])  # fmt: skip
"""Columns of STUDY/diagnoses.parquet and of STUDY/parameters.parquet (`many_recordings.md`)."""


def find_recordings(words: Sequence[str]) -> dict[str, Path]:
    """Recordings by name, in order: files, bags, and those of folders, remote stores or glob patterns.

    Raises UserError if a word gives no recording.
    """
    found: dict[Path, None] = {}
    for word in words:
        paths = sorted(map(Path, glob.glob(word, recursive=True))) if glob.has_magic(word) else [Path(word)]
        if is_remote(word):
            there = list_remote_bags(word)
        else:
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


def split_bag(name: str, path: Path, every: float) -> dict[str, str]:
    """Parts of a bag by name, `every` s each (the last 0.5 to 1.5 times that); other files are not divided.

    Parts restart after a minute without a message, or where the clock was set; both are reported on stderr.
    """
    if not is_bag(path) or split_location(path)[1] is not None:
        return {name: str(path)}
    try:
        stretches = BagSource(path).contiguous_intervals(60.0)
    except RecordingError:  # each part would be refused for the same reason
        stretches = [(0.0, every)]
    for (_, before), (after, _) in pairwise(stretches):
        print(
            f"{name}: nothing was logged, or the clock was set, from {before:.10g} to {after:.10g} s: no part of it",
            file=sys.stderr,
        )
    parts = []
    for (begin, end), behind in zip(stretches, [*(f"{begin:.12g}" for begin, _ in stretches[1:]), ""], strict=True):
        count = max(round((end - begin) / every), 1)
        borders = [*(f"{begin + k * every:.12g}" for k in range(count)), behind]
        parts += [f"#t={one},{other}" for one, other in pairwise(borders)]
    return {f"{name}{part}": f"{path}{part}" for part in parts}


def diagnose_part(path: str, folder: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Diagnose one recording, write its report to a folder, and return its rows of both tables, without its name."""
    from hydro_diagnosis.pipeline import diagnose
    from hydro_diagnosis.report.page import write_files

    try:
        found = diagnose([path], **options)
    except InputError as error:
        return {"diagnosis": {"refused": str(error)}, "parameters": []}
    write_files(found, Path(folder))
    report = found.report
    begin = report.recordings[0]["begin"]
    shares = [one["all"] for one in report.accounted.values()]
    beginning = {"begin": None if begin is None else round(1e6 * begin)}
    diagnosis = {
        **beginning, "verdict": report.verdict, "causes": [effect.id for effect in report.effects],
        "closures": len(report.closures), "explained": min(shares, default=None), "notes": report.data_quality,
        "seconds": report.seconds,
    }  # fmt: skip
    parameters = []
    for effect in report.effects:
        place = ",".join(f"{key}={one}" for key, one in effect.options.items())
        for name, number in effect.parameters.items():
            parameters.append({"cause": effect.id, "options": place, "parameter": name, **row_of(number)})
    parameters += [{"cause": "", "options": "", "parameter": one.name, **row_of(one)} for one in report.estimated]
    return {"diagnosis": diagnosis, "parameters": [{**beginning, **one} for one in parameters]}


def write_study(folder: Path, found: Mapping[str, Mapping[str, Any]]) -> None:
    """Write both tables of a study; `found`: rows by recording, as of `diagnose_part`."""
    diagnoses = [{"recording": name, **one["diagnosis"]} for name, one in found.items()]
    parameters = [{"recording": name, **row} for name, one in found.items() for row in one["parameters"]]
    for name, table, schema in (
        ("diagnoses", diagnoses, DIAGNOSES_SCHEMA),
        ("parameters", parameters, PARAMETERS_SCHEMA),
    ):
        partial = folder / f"{name}.parquet.partial"
        parquet.write_table(pa.Table.from_pylist(table, schema), partial)
        partial.replace(folder / f"{name}.parquet")


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
    options.add_argument(
        "--every", type=bounded_number(1.0), metavar="S", help="diagnose each S seconds of a bag alone"
    )
    options.add_argument("--out", required=True, type=writable_folder, metavar="STUDY", help="folder of the data set")
    jobs.add_arguments(options)
    return options


@command(InputError, ValueError, OSError)
def main() -> int:
    """Entry point; 0 if each recording was diagnosed or refused in a sentence, 2 if one could not be."""
    chosen = parser().parse_args(sys.argv[1:])
    named = {name: str(path) for name, path in find_recordings(chosen.recordings).items()}
    if chosen.every:
        named = {
            part: at for name, path in named.items() for part, at in split_bag(name, Path(path), chosen.every).items()
        }
    chosen.out.mkdir(parents=True, exist_ok=True)
    if chosen.bench:
        read_bench(chosen.bench, frozenset(chosen.estimate))  # refuses what cannot be read
    columns = ColumnMap.load(chosen.columns)
    options = {  # with the content of files in place of their paths: what is done depends on it
        "bench": read_yaml(chosen.bench) if chosen.bench else None,
        "columns": None if columns is None else str(columns),
        **{name: getattr(chosen, name) for name in ("without", "estimate", "seconds")},
    }
    folders = {name: str(chosen.out / "reports" / name.replace("#t=", "/")) for name in named}
    arguments = {name: (path, folders[name], options) for name, path in named.items()}
    found: dict[str, Any] = {}
    digest = sha256(json.dumps(options, sort_keys=True).encode()).hexdigest()[:12]
    told = jobs.job_options(chosen) | {
        "results_file": chosen.out / f"found-{digest}.jsonl",
        "label": "diagnoses",
        "unit": "recording",
    }
    try:
        found.update(jobs.run(diagnose_part, arguments, **told))
    finally:
        write_study(chosen.out, {name: found[name] for name in named if name in found})
    refused = {name: one["diagnosis"]["refused"] for name, one in found.items() if "refused" in one["diagnosis"]}
    for name, why in refused.items():
        print(f"{name}: refused: {why}", file=sys.stderr)
    print(
        f"{chosen.out}/diagnoses.parquet, parameters.parquet: {plural(len(found), 'recording')}, {len(refused)} refused"
    )
    return 0
