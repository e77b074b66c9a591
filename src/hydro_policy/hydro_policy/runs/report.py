# SPDX-License-Identifier: Apache-2.0
"""Page of a training run: learning curve, examinations, stops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hydro_bridge.pages import Section, results_page
from hydro_bridge.pages.runs import refresh_index
from hydro_core.cli.console import Table, plural, print_above_progress
from hydro_core.files.atomic import write_atomic
from hydro_policy.runs.run_directory import RunDirectory, RunRecord
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, add_legend, figure

NONE_BETTER_MESSAGE = "no policy trained here was significantly better than the one it started from: that is kept"
WHICH_CONTROLLER = """\
Which controller? For tracking the compensated law, wherever the box has it: it needs no training. Learned gains are for
a box with the paper's law alone, where they save the search of gains on the bench; the best fixed gains bound them."""
_LOSSES = ("critics_loss", "actor_loss")


def sections(record: RunRecord, curve: Path) -> list[Section]:
    """Return the sections of a training's page; `curve` is the picture of `draw_curve`."""
    episodes, exams, stops = (record.events_of(kind) for kind in ("episode", "exam", "stop"))
    last = f"; the last one: {_number(episodes[-1].get('force_rmse'))} N RMSE while it explored" if episodes else ""
    count = episodes[-1]["episode"] if episodes else 0
    summary = f"{plural(count, 'episode')}, {plural(len(stops), 'rollback')}{last}."
    if exams and episodes and not any(exam["best"] and exam["episode"] > 0 for exam in exams):
        summary += f" {NONE_BETTER_MESSAGE[0].upper()}{NONE_BETTER_MESSAGE[1:]}."
    found = [Section(heading="Learning curve", text=summary, picture=curve)]
    if exams:
        columns = {
            "episode": "episodes learnt from",
            "score": "mean of the RMSE over that of the fixed gains",
            "beaten": "sines at which it beats them",
            "rmse": "N, one for each sine",
            "kept": "whether it was the best so far",
        }
        table = Table(columns, title="Examinations")
        for event in exams:
            cells = {key: event[key] for key in ("episode", "score", "beaten")}
            table.add(**cells, rmse=", ".join(map(_number, event["rmse"])), kept="yes" if event["best"] else "no")
        found.append(Section(heading="Examinations", text="Sines with the policy's mean action.", table=table))
    happened = Table({"time": "", "event": "", "sentence": ""}, title="What happened")
    for event in record.events:
        if event["kind"] in ("start", "uncovered", "stop", "override", "end"):
            when = str(event.get("time", ""))
            with suppress(ValueError):
                when = datetime.fromisoformat(when).astimezone(timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")
            happened.add(time=when, event=event["kind"], sentence=_sentence(event))
    return [*found, Section(heading="What happened", table=happened)]


def write_page(run: RunDirectory, title: str, about: Mapping[str, Any], sections: Sequence[Section]) -> None:
    """Write report.html and the index page of all runs; a failure is reported, never raised."""
    when = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    try:
        write_atomic(run.page, results_page(title, {"written": when, **about}, sections).encode())
    except OSError as error:
        print_above_progress(f"no page of the run: {error.strerror or error}")
    refresh_index(run.path)


def draw_curve(record: RunRecord, path: Path) -> None:
    """Draw return and force RMSE of episodes, scores of examinations and rollbacks; draws nothing without data."""
    episodes, exams = record.events_of("episode"), record.events_of("exam")
    if not episodes and not exams:
        return
    learnt = [event for event in episodes if event.get(_LOSSES[0]) is not None]
    panels = 2 + bool(exams) + len(_LOSSES) * bool(learnt)
    with figure(path, panels, size=(8.0, 2.0 * panels), sharex=True) as (drawing, axes):
        numbers = [event["episode"] for event in episodes]
        axes[0].plot(numbers, [event["return"] for event in episodes], color=BLUE, marker=".", label="return")
        axes[0].set(ylabel="return")
        rmse = [event["force_rmse"] for event in episodes]
        axes[1].plot(numbers, rmse, color=ORANGE, marker=".", label="while it explores")
        axes[1].set(ylabel="force RMSE [N]")
        if exams:
            scored = [(event["episode"], event["score"]) for event in exams]
            axes[2].plot(*zip(*scored, strict=True), color=GREEN, marker=".", label="examinations")
            kept = [pair for pair, event in zip(scored, exams, strict=True) if event["best"]]
            if kept:
                ring = {"marker": "o", "markersize": 9, "markerfacecolor": "none", "linestyle": "none"}
                axes[2].plot(*kept[-1], color=GREEN, label="kept", **ring)
            for name, ratio, style in _fixed_gains(record):
                axes[2].axhline(ratio, color=GRAY, linestyle=style, label=name)
            axes[2].set(ylabel="RMSE / fixed gains'", yscale="log")
        for axis, name, color in zip(axes[-len(_LOSSES) :], _LOSSES, (BLUE, ORANGE), strict=True) if learnt else ():
            losses = [event[name] for event in learnt]
            axis.plot([event["episode"] for event in learnt], losses, color=color, marker=".", label="last updates")
            axis.set(ylabel=name.replace("_", " "))
        stops, episode = [], 0.5  # rollbacks, half an episode behind the last one
        for event in record.events:
            episode = event["episode"] + 0.5 if event["kind"] == "episode" else episode
            stops += [episode] if event["kind"] == "stop" else []
        for panel in axes:
            for n, stop in enumerate(stops):
                panel.axvline(stop, color=RED, linewidth=0.8, label=None if n else "rolled back")
            add_legend(panel)
        axes[-1].set(xlabel="episodes")
        axes[-1].xaxis.get_major_locator().set_params(integer=True)
        drawing.align_ylabels()


def _fixed_gains(record: RunRecord) -> list[tuple[str, float, str]]:
    """Return name, score and line style of fixed gains: the reference, and (15, 5) if the comparison has it."""
    rmse: dict[str, list[float]] = {}
    for event in record.events_of("trial"):
        rmse.setdefault(event["controller"], []).append(event["rmse"] or math.inf)
    lines = [("fixed gains", 1.0, "--")]
    reference, base = rmse.get("fixed (90, 15)", []), rmse.get("fixed (15, 5)", [])
    if base and len(base) == len(reference):
        ratio = sum(own / other for own, other in zip(base, reference, strict=True)) / len(base)
        lines += [("fixed (15, 5)", ratio, ":")] if math.isfinite(ratio) else []
    return lines


def _sentence(event: Mapping[str, Any]) -> str:
    if event.get("sentence"):
        return str(event["sentence"])
    if event["kind"] == "start":
        what = "goes on" if event.get("resumed") else f"from {event.get('start') or 'new networks'}"
        return f"plant {event.get('plant')}, {what}"
    return "complete" if event.get("complete") else "ended before all was done; it can be resumed"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"  # non-finite values are null
