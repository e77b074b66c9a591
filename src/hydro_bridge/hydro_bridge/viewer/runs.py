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

from hydro_bridge.pages import environment
from hydro_core.cli.console import Table, UserError, add_json_argument, command, make_parser, plural
from hydro_core.files.atomic import write_atomic

INDEX_FILE = "index.html"
INDEX_MARKER = "<!-- hydro: a front page of runs -->"
"""Marker of a page that may be overwritten."""
RUNS_FOLDER = "runs"
"""Name of the folder whose index page commands update automatically."""


@dataclass(frozen=True, kw_only=True)
class RunEntry:
    """Entry of one run on the index page; addresses are relative to the folder of all runs."""

    name: str
    kind: str
    """training, evaluation, diagnosis, proof, pretraining, recording, or unfinished: it has recorded, and no more."""
    summary: str
    changed: float
    """Time of the last change, s since 1970."""
    when: str
    """Time of the last change, as text in UTC."""
    pages: tuple[str, ...]
    pictures: tuple[str, ...]
    recordings: tuple[str, ...]
    """Recordings without a page."""
    score: float | None = None
    """Of a training's best policy: mean ratio of its RMSE to that of the fixed gains, in its evaluations."""


def list_runs(folder: Path) -> list[RunEntry]:
    """Return the runs in a folder, newest first; other entries are skipped."""
    entries = []
    for run in folder.iterdir():
        with suppress(OSError):  # no permission, or removed meanwhile
            if run.is_dir() and not run.name.startswith(".") and (entry := _entry(folder, run)) is not None:
                entries.append(entry)
    return sorted(entries, key=lambda entry: -entry.changed)


def write_index(folder: Path) -> Path:
    """Write the index page of a folder of runs, and return its path.

    Raises OSError: the folder cannot be read, or the page cannot be written, for instance because a foreign file has
    its name.
    """
    index, here = folder / INDEX_FILE, folder.resolve()
    if index.is_file() and INDEX_MARKER not in index.read_text(encoding="utf-8", errors="replace"):
        raise FileExistsError(errno.EEXIST, "is another page than one of runs: move it away", str(index))
    made = environment("hydro_bridge", "viewer/page")
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


_KIND_FILES = {
    "training": "run.json",
    "diagnosis": "report.json",
    "proof": "proof.html",
    "pretraining": "pretrain.yaml",
    "evaluation": "evaluation.json",
    "recording": "metadata.yaml",
    "unfinished": "bag/metadata.yaml",
}
"""Files that identify the kind of a run; the first match counts."""


def _entry(folder: Path, run: Path) -> RunEntry | None:
    kind = next((kind for kind, file in _KIND_FILES.items() if (run / file).is_file()), "")
    if not kind:
        return None
    bags = [run] if kind == "recording" else sorted(path.parent for path in run.glob("*/metadata.yaml"))
    beside = [run.with_name(f"{run.name}.html")] if kind == "recording" else []
    pages = [page for page in (*sorted(run.glob("*.html")), *beside) if page.is_file()]
    unseen = [bag for bag in bags if not bag.with_name(f"{bag.name}.html").is_file()]
    summary, score = _told(run, kind)

    def relative(paths: list[Path]) -> tuple[str, ...]:
        return tuple(path.relative_to(folder).as_posix() for path in paths)

    changed = max(path.stat().st_mtime for path in (run, run / _KIND_FILES[kind]))
    return RunEntry(
        name=run.name,
        kind=kind,
        summary=summary,
        changed=changed,
        when=datetime.fromtimestamp(changed, timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        pages=relative(pages),
        pictures=relative(sorted(run.glob("*.png"))),
        recordings=relative(unseen),
        score=score,
    )


def _told(run: Path, kind: str) -> tuple[str, float | None]:
    """Return summary and score of a training, the summary of a diagnosis; nothing of one of another version."""
    summary, score = "", None
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
        if kind == "training":
            events = json.loads((run / "run.json").read_text(encoding="utf-8"))["events"]
            episodes = [event for event in events if event["kind"] == "episode"]
            last = f", the last one with an RMSE of {episodes[-1]['force_rmse']:.1f} N" if episodes else ""
            ends = [event for event in events if event["kind"] in ("stop", "end") and event.get("sentence")]
            summary = f"{plural(len(episodes), 'episode')}{last}.{' ' + ends[-1]['sentence'] if ends else ''}"
            best = [event["score"] for event in events if event["kind"] == "exam" and event["best"]]
            score = float(best[-1]) if best else None
        elif kind == "diagnosis":
            report = json.loads((run / "report.json").read_text(encoding="utf-8"))
            names = ", ".join(effect["id"].replace("_", " ") for effect in report["effects"])
            summary = f"{report['verdict'].replace('_', ' ')}{': ' + names if names else ''}"
    return summary, score


COLUMNS = {
    "run": "folder",
    "kind": "what it was",
    "changed": "",
    "score": "of a training's best policy: RMSE over that of fixed gains, mean over the sines examined",
    "summary": "",
}


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
    table = Table(COLUMNS, title=str(index))
    for run in list_runs(options.folder):
        table.add(run=run.name, kind=run.kind, changed=run.when, score=run.score, summary=run.summary)
    table.show(options.json)
    if options.open:
        webbrowser.open(index.absolute().as_uri())
