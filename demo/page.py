# SPDX-License-Identifier: Apache-2.0
"""The story on one page: error on the bench before and after, the force at 1 Hz, and what the diagnosis said."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from demo.trial import Entry, Story
from hydro_core.signals import Flag
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, figure

SHOWN = 2.0
"""s of the force that are drawn."""
_COLORS = {"believed": RED, "corrected": BLUE, "-": GRAY}


def draw(story: Story, path: Path) -> None:
    """Write the page, a PNG or PDF by the suffix of `path`."""
    with figure(path, 4, size=(8.3, 10.0), height_ratios=(0.35, 1.0, 1.0, 1.2)) as (
        drawing,
        (words, before, after, bars),
    ):
        drawing.suptitle(
            "A policy, a bench that its simulation did not know, and the diagnosis between", weight="semibold"
        )
        _words(words, story)
        _force(before, "Trained in the simulation as believed, on the bench", story.tried("pretrained"))
        _force(after, "Trained in the simulation as corrected, on the bench", story.tried("retrained"))
        after.set_xlabel("time [s]")
        _bars(bars, story)


def _words(axes: Any, story: Story) -> None:
    report = story.report
    lines = [f"Verdict of the diagnosis: {report['verdict'].replace('_', ' ')}, from recordings under fixed gains."]
    for effect in report["effects"]:
        numbers = ", ".join(
            f"{name} {one['value']:.4g} {one['unit']}"
            + (" (95 % {:.4g} to {:.4g})".format(*one["ci95"]) if one["ci95"] else "")
            for name, one in effect["parameters"].items()
        )
        lines.append(f"{effect['id']}: {effect['sentence']} {numbers}.")
    for channel, error in report["fit"]["holdout"].items():
        if error["rmse_before"] > 2.0 * error["noise_floor"]:
            shown = (channel.replace("_", " "), *(error[key] for key in ("rmse_before", "rmse_after", "noise_floor")))
            text = "Held-out {}, 70 ms ahead: {:.3g} {unit} before, {:.3g} after, noise {:.3g}."
            lines.append(text.format(*shown, unit=error["unit"]))
    axes.axis("off")
    wrapped = "\n".join("\n".join(textwrap.wrap(line, 100, subsequent_indent="    ")) for line in lines[:7])
    axes.text(0.0, 1.0, wrapped, va="top", fontsize=9, linespacing=1.5, transform=axes.transAxes)


def _force(axes: Any, title: str, entries: list[Entry]) -> None:
    """Force at 1 Hz of each seed, from arming on; a cross marks where the box tripped."""
    axes.set_title(title)
    for k, entry in enumerate(entries):
        states = entry.bench.trace[entry.bench.trace["time"] <= SHOWN]
        color, tripped = (BLUE, ORANGE, GREEN)[k % 3], bool(states["flags"][-1] & Flag.TRIPPED)
        if k == 0:
            asked = entry.simulated.trace
            axes.plot(asked["time"], asked["reference_force"], color=GRAY, linestyle="--", label="reference, 1 Hz")
        outcome = "tripped" if tripped else f"{entry.bench.rmse['1 Hz']:.1f} N"
        label = f"{entry.name.split(', ')[1]}: {outcome}"
        axes.plot(states["time"], states["load_force"], color=color, linewidth=0.9, label=label)
        if tripped:
            axes.plot(states["time"][-1], states["load_force"][-1], "x", color=color, markersize=9, markeredgewidth=2)
    axes.set(ylabel="load force [N]", xlim=(0.0, SHOWN))
    axes.legend(loc="lower right", ncols=2, frameon=True, framealpha=0.9, edgecolor="none")


def _bars(axes: Any, story: Story) -> None:
    """Mean error on the bench, and beside it what the simulation had foretold."""
    entries = story.entries[::-1]
    at = np.arange(len(entries))
    finite = [entry.bench.mean for entry in entries if np.isfinite(entry.bench.mean)]
    limit = 1.15 * max(
        [*finite, *(entry.simulated.mean for entry in entries if np.isfinite(entry.simulated.mean)), 1.0]
    )
    for y, entry in zip(at, entries, strict=True):
        color, mean = _COLORS[entry.chosen], entry.bench.mean
        if np.isfinite(mean):
            axes.barh(y, mean, 0.6, color=color)
            axes.text(mean, y, f" {mean:.1f} N", va="center", fontsize=8)
        else:
            axes.barh(y, limit, 0.6, color="none", edgecolor=color, hatch="////", linewidth=0.6)
            text = f"tripped in {entry.bench.trips} of {len(entry.bench.rmse)} runs"
            axes.text(0.02 * limit, y, text, va="center", fontsize=8, backgroundcolor="white")
        if np.isfinite(entry.simulated.mean):
            axes.plot(entry.simulated.mean, y, marker="|", color="black", markersize=11, markeredgewidth=1.6)
    axes.set_yticks(at, [entry.name for entry in entries])
    axes.set(xlim=(0.0, limit), xlabel="mean RMSE on the bench over 0.5, 1, 1.5 and 2 Hz [N]; |: as simulated")
    axes.set_title("Red: chosen in the simulation as believed. Blue: as corrected")
    axes.grid(axis="y", visible=False)
