# SPDX-License-Identifier: Apache-2.0
"""Writes the front page of a folder of runs: what each was, its pictures and pages. Opens it, too.

ros2 run hydro_bridge runs                 # runs/index.html
ros2 run hydro_bridge runs archive --json archive.json
"""

from __future__ import annotations

import errno
import json
import shlex
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hydro_bridge.pages import environment
from hydro_core.cli.console import Table, UserError, add_json_argument, command, make_parser, plural
from hydro_core.files.atomic import write_atomic

INDEX_MARKER = "<!-- hydro: a front page of runs -->"
"""Marker of a page that may be overwritten."""
RUNS_FOLDER = "runs"
"""Name of the folder whose index page commands update automatically."""
KIND_FILES = {
    "training": "run.json",
    "diagnosis": "report.json",
    "proof": "proof.html",
    "pretraining": "pretrain.yaml",
    "evaluation": "evaluation.json",
    "recording": "metadata.yaml",
    "unfinished": "bag/metadata.yaml",
}
"""Files that identify the kind of a run, the first match; unfinished: it has recorded, and no more."""


@dataclass(frozen=True, kw_only=True)
class RunEntry:
    """Entry of one run on the index page; addresses are relative to the folder of all runs."""

    name: str
    kind: str
    """One of `KIND_FILES`."""
    changed: datetime
    """Time of the last change, UTC."""
    pages: tuple[str, ...]
    pictures: tuple[str, ...]
    recordings: tuple[str, ...]
    """Recordings without a page."""
    summary: str = ""
    score: float | None = None
    """Of a training's best policy: mean ratio of its RMSE to that of the fixed gains, in its evaluations."""


def list_runs(folder: Path) -> list[RunEntry]:
    """Return the runs in a folder, newest first; other entries are skipped."""
    entries = []
    for run in folder.iterdir():
        with suppress(OSError):  # no permission, or removed meanwhile
            kind = next((kind for kind, file in KIND_FILES.items() if (run / file).is_file()), "")
            if kind and not run.name.startswith("."):
                entries.append(_entry(run, kind))
    return sorted(entries, key=lambda entry: entry.changed, reverse=True)


def write_index(folder: Path) -> Path:
    """Write the index page of a folder of runs, and return its path.

    Raises OSError: the folder cannot be read, or the page cannot be written, for instance because a foreign file has
    its name.
    """
    index, here = folder / "index.html", folder.resolve()
    if index.is_file() and INDEX_MARKER not in index.read_text(encoding="utf-8", errors="replace"):
        raise FileExistsError(errno.EEXIST, "is another page than one of runs: move it away", str(index))
    made = environment("hydro_bridge", "pages/static")
    made.filters["in_shell"] = lambda bag: shlex.quote(str(here / bag))
    content = made.get_template("runs.html").render(
        title="Runs", runs=list_runs(folder), folder=here.name, mark=INDEX_MARKER
    )
    write_atomic(index, content.encode())
    return index


def refresh_index(run: Path) -> None:
    """Update the index page above a finished run, if its folder is called `RUNS_FOLDER`; fails silently.

    A page never changes the outcome of a run.
    """
    folder = run.absolute().parent
    if folder.name == RUNS_FOLDER:
        with suppress(Exception):
            write_index(folder)


def _entry(run: Path, kind: str) -> RunEntry:
    def relative(paths: list[Path]) -> tuple[str, ...]:
        return tuple(path.relative_to(run.parent).as_posix() for path in paths if path.exists())

    bags = [run] if kind == "recording" else sorted(path.parent for path in run.glob("*/metadata.yaml"))
    changed = max(path.stat().st_mtime for path in (run, run / KIND_FILES[kind]))
    told: dict[str, Any] = {}
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):  # of another version
        if kind == "training":
            told = _training(json.loads((run / "run.json").read_text(encoding="utf-8"))["events"])
        elif kind == "diagnosis":
            report = json.loads((run / "report.json").read_text(encoding="utf-8"))
            effects = ", ".join(effect["id"] for effect in report["effects"])
            told = {"summary": f"{report['verdict']}{': ' + effects if effects else ''}".replace("_", " ")}
    return RunEntry(
        name=run.name,
        kind=kind,
        changed=datetime.fromtimestamp(changed, timezone.utc),
        pages=relative([*sorted(run.glob("*.html")), run.with_name(f"{run.name}.html")]),
        pictures=relative(sorted(run.glob("*.png"))),
        recordings=relative([bag for bag in bags if not bag.with_name(f"{bag.name}.html").is_file()]),
        **told,
    )


def _training(events: list[dict[str, Any]]) -> dict[str, Any]:
    episodes = [event for event in events if event["kind"] == "episode"]
    last = f", the last one with an RMSE of {episodes[-1]['force_rmse']:.1f} N" if episodes else ""
    ends = [f" {event['sentence']}" for event in events if event["kind"] in ("stop", "end") and event.get("sentence")]
    best = [float(event["score"]) for event in events if event["kind"] == "exam" and event["best"]]
    summary = f"{plural(len(episodes), 'episode')}{last}.{''.join(ends[-1:])}"
    return {"summary": summary, "score": best[-1] if best else None}


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("runs", __doc__)
    parser.add_argument(
        "folder", nargs="?", type=Path, default=Path(RUNS_FOLDER), help=f"of runs (default {RUNS_FOLDER})"
    )
    parser.add_argument("--no-open", dest="open", action="store_false", help="open no browser")
    add_json_argument(parser)
    options = parser.parse_args()
    if not options.folder.is_dir():
        raise UserError(f"{options.folder} is not a folder: name one that holds runs")
    index = write_index(options.folder)
    score = "of a training's best policy: RMSE over that of fixed gains, mean over the sines examined"
    columns = {"run": "folder", "kind": "what it was", "changed": "", "score": score, "summary": ""}
    table = Table(columns, title=str(index))
    for run in list_runs(options.folder):
        changed = f"{run.changed:%Y-%m-%d %H:%M UTC}"
        table.add(run=run.name, kind=run.kind, changed=changed, score=run.score, summary=run.summary)
    table.show(options.json)
    if options.open:
        webbrowser.open(index.absolute().as_uri())
