# SPDX-License-Identifier: Apache-2.0
"""Report of a pretraining: the table and the plot of its learning curve."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.cli.console import Table
from hydro_bridge.pages import Section, results_page
from hydro_bridge.signals import FloatArray
from hydro_policy.pretraining.examination import REFERENCE_GAINS
from hydro_policy.task.cases import Case
from hydro_sim.plotting import BLUE, figure, legend

CURVE = "curve.png"
"""File name of the learning curve in a pretraining's folder."""


def curve_page(
    folder: Path, history: Sequence[dict[str, Any]], cases: Sequence[Case], reference: FloatArray,
    about: Mapping[str, Any],
) -> str:  # fmt: skip
    """Return the page of a pretraining in `folder`, with its `CURVE`."""
    table = Section(heading="Rounds", table=curve_table(history, cases, reference))
    sections = [Section(heading="Learning curve", picture=folder / CURVE), table]
    return results_page(f"Pretraining {folder.name}", about, sections)


def curve_table(history: Sequence[dict[str, Any]], cases: Sequence[Case], reference: FloatArray) -> Table:
    """Return the table with one row per round, the first for fixed gains."""
    kp, ki = REFERENCE_GAINS
    drawn = bool(history) and history[0]["changed"] is not None
    columns = {
        "episode": "episodes so far",
        "return": "mean return of the round's episodes",
        "trips": "times a box tripped in them",
        **{case.name: "force RMSE [N] of the mean action" for case in cases},
        "score": f"mean over cases and benches of the RMSE over that of fixed ({kp:g}, {ki:g}) there",
        **({"changed": "the same over the drawn benches alone"} if drawn else {}),
        "updates": "gradient updates so far",
    }
    table = Table(columns, title="pretraining")
    names = [case.name for case in cases]
    fixed: dict[str, Any] = dict(zip(names, map(float, reference), strict=True))
    fixed |= {"return": math.nan, "trips": 0, "score": 1.0, "updates": 0} | ({"changed": 1.0} if drawn else {})
    table.add(episode=f"fixed ({kp:g}, {ki:g})", **fixed)
    for entry in history:
        values = {key: entry[key] for key in columns.keys() & entry.keys() - {"episode"}}
        table.add(**values, episode=str(entry["episode"]), **dict(zip(names, entry["rmse"], strict=True)))
    return table


def draw_curve(history: Sequence[dict[str, Any]], cases: Sequence[Case], reference: FloatArray, path: Path) -> None:
    """Draw the episodes' return, and RMSE of the mean action relative to that of the fixed gains, against episodes."""
    episodes = np.array([entry["episode"] for entry in history])
    rmse = np.array([entry["rmse"] for entry in history], np.float64)
    with figure(path, 2, size=(7.0, 5.5), sharex=True) as (_, (returns, ratios)):
        returns.plot(episodes, [-entry["return"] for entry in history], color=BLUE, marker=".")
        returns.set(yscale="log", ylabel="- return")
        for column, case in enumerate(cases):
            ratios.plot(episodes, rmse[:, column] / reference[column], marker=".", label=case.name)
        changed = [entry["changed"] for entry in history]
        if None not in changed:
            ratios.plot(episodes, changed, color="k", marker=".", label="drawn benches, mean")
        ratios.axhline(1.0, color="0.5", linestyle="--")
        ratios.set(xlabel="episodes", ylabel="RMSE / fixed ({:g}, {:g})".format(*REFERENCE_GAINS))
        legend(ratios)
