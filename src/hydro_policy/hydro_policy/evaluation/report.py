# SPDX-License-Identifier: Apache-2.0
"""Results of an evaluation: the table (paper Table rmse), JSON, the tracking plot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.pages import Section
from hydro_core.cli.console import Table
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_core.signals import FloatArray
from hydro_policy.evaluation.controllers import PAPER_LAW_COMMAND
from hydro_policy.evaluation.gain_search import GridSearch
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.task.cases import DISTURBED_SHARE_MAX, EvaluationSettings, Score, relative_scores
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, add_legend, figure


def table(session: TrialRunner[Comparison]) -> Table:
    """Return the table of force RMSE, controllers by cases, with mean and, for repeated runs, spread."""
    cases = [case.name for case in session.plan.settings.cases]
    mark = f"*: the machine was held up in more than {DISTURBED_SHARE_MAX:.0%} of a run: no figure of this controller"
    disturbed = mark if any(score.disturbed for score in session.scores) else ""
    columns = {"controller": disturbed, "authority": "K_p [1/s] and K_i [1/s^2] in all", **dict.fromkeys(cases, "")}
    spread = ", mean and standard deviation over the repeats" if session.plan.settings.repeats > 1 else ""
    brackets = (
        "; in brackets of the force on the specimen" if any(math.isfinite(s.true_rmse) for s in session.scores) else ""
    )
    force = f"{session.plan.settings.amplitude:g} N"
    title = f"Force RMSE [N], and in % of the reference's RMS, sines of {force}{spread}{brackets}"
    result = Table(columns, title=title)
    gain_ranges = {controller.name: controller.gain_range for controller in session.plan.controllers}
    for name in dict.fromkeys(score.controller for score in session.scores):
        (kp, ki), limits = session.override.base, gain_ranges[name]
        ends = (
            (kp + limits.delta_kp_min, kp + limits.delta_kp_max),
            (ki + limits.delta_ki_min, ki + limits.delta_ki_max),
        )
        total = ", ".join(f"{low:g}" if low == high else f"{low:g} to {high:g}" for low, high in ends)
        cells = {case: _cell(runs(session.scores, name, case)) for case in cases}
        result.add(controller=name, authority=total, **cells)
    return result


def best(session: TrialRunner[Comparison]) -> str:
    """Return a sentence on the best controller and its margin; without two to compare the reason, or an empty text.

    The best has the smallest mean over the references of RMSE relative to the smallest RMSE of any controller there.
    The RMSE is that of the force on the specimen if the law compensates the load cell (`LiveCompensation.cell`) and it
    is known. A controller with a stopped or disturbed run is left out. Where the best needs the compensated law, a
    second sentence names the best of those under the paper's law.
    """
    cases = [case.name for case in session.plan.settings.cases]
    names = dict.fromkeys(score.controller for score in session.scores)
    of_specimen = session.compensation is not None and session.compensation.cell is not None
    of_specimen = of_specimen and all(
        math.isfinite(score.true_rmse) for score in session.scores if math.isfinite(score.rmse)
    )
    rmse = {name: np.full(len(cases), np.nan) for name in names}
    for name in names:
        for column, case in enumerate(cases):
            found = runs(session.scores, name, case)
            if found and not any(score.disturbed for score in found):
                rmse[name][column] = np.mean([score.true_rmse if of_specimen else score.rmse for score in found])
    scores = relative_scores(rmse)
    if len(scores) < 2:
        held_up = dict.fromkeys(score.controller for score in session.scores if score.disturbed)
        return f"Nobody is named the best: the machine was held up in runs of {', '.join(held_up)}." if held_up else ""
    order = sorted(scores, key=scores.__getitem__)
    papers = {controller.name for controller in session.plan.controllers if controller.law is PAPER_LAW_COMMAND}
    under_it = [name for name in order if name in papers]
    told = f"Best: {_margin(order, rmse)}"
    if order[0] not in papers and len(under_it) > 1:
        told += f". Best in a box that has the paper's law alone: {_margin(under_it, rmse)}"
    return told + (", as the specimen feels it." if of_specimen else ".")


def _margin(order: Sequence[str], rmse: Mapping[str, FloatArray]) -> str:
    first, second, *_ = order
    ratio = rmse[first] / rmse[second]
    return f"{first}, with {ratio.min():.2f} to {ratio.max():.2f} times the error of the next, {second}"


def runs(scores: list[Score], controller: str, case: str) -> list[Score]:
    """Return the runs of one controller on one reference."""
    return [score for score in scores if score.controller == controller and score.case == case]


def _cell(scores: list[Score]) -> float | str:
    stopped = sum(bool(score.stopped) for score in scores)
    if stopped:
        return f"stopped {stopped}/{len(scores)}"
    if not scores:
        return "-"
    values, true_rmse = [score.rmse for score in scores], float(np.mean([score.true_rmse for score in scores]))
    shown = f"{np.mean(values):.2f} +- {np.std(values, ddof=1):.2f}" if len(values) > 1 else f"{values[0]:.2f}"
    share = float(np.mean([100.0 * score.rmse / score.reference_rms for score in scores]))
    if math.isfinite(share):
        shown = f"{shown}, {share:.2f} %"
    if math.isfinite(true_rmse):
        shown = f"{shown} ({true_rmse:.2f})"
    if any(score.disturbed for score in scores):
        return f"{shown} *"
    return shown if len(values) > 1 or math.isfinite(true_rmse) or math.isfinite(share) else float(shown)


def grid_table(search: GridSearch, settings: EvaluationSettings) -> Table:
    """Return the table of all pairs of gains that were tried, best first."""
    cases = [case.name for case in settings.cases]
    columns = {"K_p": "1/s", "K_i": "1/s^2", "score": "mean of RMSE over the smallest RMSE of the column"}
    table = Table({**columns, **dict.fromkeys(cases, "")}, title="Fixed gains, force RMSE [N]; inf: stopped")
    scores = search.scores
    for pair in sorted(scores, key=scores.__getitem__):
        rmse = {case: float(value) for case, value in zip(cases, search.results[pair], strict=True)}
        table.add(**{"K_p": pair[0], "K_i": pair[1], "score": scores[pair], **rmse})
    return table


def write_json(session: TrialRunner[Comparison], path: Path, notes: Mapping[str, Any]) -> None:
    """Write settings, every single run, and `notes`; non-finite values become null, a missing folder is created."""
    newtons = dict.fromkeys(("rmse", "reference_rms", "true_rmse", "peak"), "N")
    units = {**newtons, "chatter": "A/s", "frequency": "Hz", **dict.fromkeys(("samples", "lost", "held"), "samples")}
    runs = [{**asdict(score), "spoilt": score.disturbed} for score in session.scores]
    about = {"settings": session.plan.settings, "units": units, "warnings": session.warnings}
    content = {**notes, **about, "runs": runs}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, encode_json(content))


def sections(session: TrialRunner[Comparison], picture: Path) -> list[Section]:
    """Return the sections of an evaluation's page; `picture`: file written by `plot`."""
    shown = table(session)
    found = [Section(heading=shown.title, text=" ".join([best(session), *session.warnings]).strip(), table=shown)]
    return [*found, Section(heading="Tracking at the fastest sine", picture=picture)] if picture.is_file() else found


def plot(session: TrialRunner[Comparison], path: Path) -> None:
    """Draw the paper's two figures at the fastest sine: tracking and errors of all controllers, gains of the first."""
    sines = session.plan.settings.frequencies
    case = f"{max(sines):g} Hz" if sines else session.plan.settings.cases[0].name
    traces = {t.controller: t for t in session.traces if t.case == case}
    path.unlink(missing_ok=True)  # an earlier evaluation's picture is not this one's
    if not traces:
        return
    first = next(iter(traces.values()))
    with figure(path, 3, size=(8.0, 6.5), sharex=True, height_ratios=(3, 2, 1.5)) as (drawing, (force, error, gain)):
        drawing.suptitle(f"Force tracking, {session.plan.settings.amplitude:g} N, {case}", x=0.01, ha="left")
        force.plot(first.states["time"], first.states["reference_force"], color=GRAY, linestyle="--", label="reference")
        for color, trace in zip((BLUE, ORANGE, RED, GREEN), traces.values(), strict=False):
            states = trace.states
            e = states["reference_force"] - states["load_force"]
            force.plot(states["time"], states["load_force"], color=color, label=trace.controller)
            rmse = np.sqrt(np.mean(e**2))
            disturbed = any(score.disturbed for score in runs(session.scores, trace.controller, case))
            error.plot(states["time"], e, color=color, label=f"{rmse:.1f} N RMSE" + (" *" if disturbed else ""))
        gains = first.states["time"], first.states["proportional_gain"], first.states["integral_gain"]
        gain.plot(gains[0], gains[1], color=GREEN, label=f"$K_p$ of {first.controller}")
        gain.plot(gains[0], gains[2], color=ORANGE, label="$K_i$")
        gain.set(ylabel="[1/s], [1/s²]", xlabel="time [s]", xlim=(gains[0][0], gains[0][-1]))
        force.set_ylabel("load force [N]")
        error.set_ylabel("error [N]")
        for panel in (force, error, gain):
            add_legend(panel)
        drawing.align_ylabels()
