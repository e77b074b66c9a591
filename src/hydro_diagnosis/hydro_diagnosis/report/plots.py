# SPDX-License-Identifier: Apache-2.0
"""Plots of the report as SVG text: signals, residuals, effects and curves."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import CHANNELS, Effect, FloatArray
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report_json import EffectReport
from hydro_sim.plotting import BLUE, GRAY, ORANGE, SKY, UNITS, add_legend, figure

_CHANNEL_LABELS = {
    "pressure_a": ("pressure A", "kPa", 1e-3),
    "pressure_b": ("pressure B", "kPa", 1e-3),
    "motion": ("force balance", "N", 1.0),
    "load": ("load force", "N", 1.0),
    "hydraulic": ("hydraulic\nforce", "N", 1.0),
}
_AXIS_LABELS = {
    "position": ("piston position [mm]", 1e3),
    "velocity": ("piston velocity [mm/s]", 1e3),
    "current": ("valve current [mA]", 1e3),
    "pressure_a": ("pressure A [MPa]", 1e-6),
    "pressure_b": ("pressure B [MPa]", 1e-6),
    "pressure_difference": ("pressure A - pressure B [MPa]", 1e-6),
    "time": ("time [s]", 1.0),
}


@contextmanager
def svg(rows: int, size: tuple[float, float], **layout: Any) -> Iterator[tuple[Any, StringIO]]:
    """Context of a figure with `rows` axes: yields these, and a buffer that contains the SVG text for HTML at exit."""
    text = StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plot.svg"
        with figure(path, rows, size=size, **layout) as (drawing, axes):
            yield axes, text
            drawing.align_ylabels(axes)
        whole = path.read_text(encoding="utf-8")
    text.write(whole[whole.index("<svg") :])


def signals_plot(
    time: FloatArray, words: str, measured: Mapping[str, FloatArray], before: Mapping[str, FloatArray],
    after: Mapping[str, FloatArray],
) -> str:  # fmt: skip
    """Plot signals by channel, SI units, (n,): measured, simulated with the bench file, and with the corrected bench.

    `time`: s, shape (n,), `words`: label of the time axis.
    """
    every = max(len(time) // 1500, 1)
    with svg(len(measured), (9.0, 1.5 * len(measured) + 0.5), sharex=True) as (axes, text):
        for axis, name in zip(axes, measured, strict=True):
            label, unit, factor = UNITS[name]
            for signal, color, style, width, what in (
                (before, ORANGE, "-", 0.8, "bench file"),
                (measured, "black", "-", 2.0, "measured"),
                (after, SKY, "--", 0.9, "corrected"),
            ):
                shown = factor * signal[name][::every]
                axis.plot(time[::every], shown, style, color=color, linewidth=width, label=what)
            whole = factor * measured[name]
            room = 0.4 * max(float(np.ptp(whole)), 1e-9)
            axis.set_ylim(whole.min() - room, whole.max() + room)
            axis.set_ylabel(f"{label}\n[{unit}]")
        add_legend(axes[0])
        axes[-1].set_xlabel(words)
    return text.getvalue()


def residual_plot(found: Diagnosis) -> str:
    """Plot the residuals of the first segment without and with the claims, and the 2-sigma band of the noise."""
    problem, layout = found.problem, found.problem.layout
    before, after = found.outcome.baseline_fit.residual, found.assessment.fit.residual
    present = [k for k in range(len(CHANNELS)) if np.any(layout.channel == k)]

    with svg(len(present), (9.0, 1.5 * len(present) + 0.5), sharex=True) as (axes, text):
        for axis, k in zip(axes, present, strict=True):
            at = (layout.channel == k) & (layout.segment == 0)
            name, unit, factor = _CHANNEL_LABELS[CHANNELS[k]]
            scale = problem.noise[CHANNELS[k]] * factor
            axis.plot(layout.time[at], before[at] * scale, color=ORANGE, linewidth=0.6, label="before")
            axis.plot(layout.time[at], after[at] * scale, color=BLUE, linewidth=0.6, label="after")
            axis.axhspan(-2 * scale, 2 * scale, color=GRAY, alpha=0.25, linewidth=0, label="noise, 2 sigma")
            axis.set_ylabel(f"{name} [{unit}]")
        add_legend(axes[0])
        axes[-1].set_xlabel("time [s]")
    return text.getvalue()


def effect_plot(found: Diagnosis, effect: EffectReport) -> str:
    """Plot the residuals without an effect, and its fitted signature, over the variable on which it depends."""
    problem, layout = found.problem, found.problem.layout
    fit, place = found.assessment.fit, (effect.id, effect.options)
    claim = next(one for one in fit.claims if (one.effect.id, dict(one.effect.options)) == place)
    without = problem.residual(fit.claims_without(claim))
    signature = without - fit.residual
    power = np.bincount(layout.channel, np.square(signature), len(CHANNELS))
    channel = int(np.argmax(power))
    at = layout.channel == channel
    variable = _variable(claim.effect, found)
    name, unit, factor = _CHANNEL_LABELS[CHANNELS[channel]]
    scale = problem.noise[CHANNELS[channel]] * factor
    x = np.concatenate(
        [
            np.interp(layout.time[at & (layout.segment == k)], model.time, model.variable(variable))
            for k, model in enumerate(problem.models)
        ]
    )
    label, units = _AXIS_LABELS[variable]

    with svg(1, (8.0, 3.2)) as (axes, text):
        shown = np.random.default_rng(0).permutation(len(x))[:4000]
        axes[0].plot(
            x[shown] * units, without[at][shown] * scale, ".", color=GRAY, markersize=1.5, alpha=0.5, label="recorded"
        )
        centers, means = binned(x, without[at])
        axes[0].plot(centers * units, means * scale, "o", color=ORANGE, markersize=3, label="mean")
        centers, means = binned(x, signature[at])
        axes[0].plot(centers * units, means * scale, color=BLUE, label="fitted effect")
        axes[0].set_xlabel(label)
        axes[0].set_ylabel(f"unexplained\n{name} [{unit}]")
        add_legend(axes[0])
    return text.getvalue()


def curves_plot(found: Diagnosis) -> str:
    """Plot the missing force or flow of each equation over its variable, and the claimed effects' part of it."""
    curves = found.report.curves

    with svg(len(curves), (8.0, 2.6 * len(curves))) as (axes, text):
        for axis, curve in zip(axes, curves, strict=True):
            label, units = _AXIS_LABELS[curve.over]
            words, factor = ("flow [l/min]", 6e4) if curve.unit_y == "m3/s" else ("force [N]", 1.0)
            x, y, low, high, named = (
                np.array(values) * size
                for values, size in zip((curve.x, curve.y, curve.low, curve.high, curve.named), (units, *[factor] * 4),
                                        strict=True)
            )  # fmt: skip
            axis.errorbar(x, y, [y - low, high - y], fmt="o", color=GRAY, markersize=3, label="missing, 95 %")
            axis.plot(x, named, color=BLUE, linewidth=1.0, label="named")
            axis.axhline(0.0, color=ORANGE, linewidth=0.8, label="bench file")
            axis.set_xlabel(label)
            axis.set_ylabel(f"missing in\n{curve.equation.replace('_', ' ')}: {words}")
        add_legend(axes[0])
    return text.getvalue()


def _variable(cause: Effect, found: Diagnosis) -> str:
    have, effect = set(found.problem.models[0].channels), cause.id
    if effect.startswith(("friction", "moving_mass", "force_offset", "sensor_lag")):
        return "velocity"
    if effect == "leakage_internal":
        return "pressure_difference"
    if effect in ("entrained_air", "pressure_sensor_bias", "bulk_modulus") and "pressure_a" in have:
        return "pressure_a"
    if effect == "valve_gain_drift":
        return "time"
    if effect.startswith(("valve", "transport", "supply", "tank")) and "valve_current" in have:
        return "current"
    return "position"


def binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bin means of x and of y, in equal-width bins refined where data are dense; bins of fewer than 5 are omitted."""
    even = np.linspace(x.min(), x.max(), 37)
    dense = np.quantile(x, np.linspace(0.0, 1.0, 37))
    finer = dense[1:][np.diff(dense) < 0.5 * (even[1] - even[0])]
    coarse = [edge for edge in even if not len(finer) or np.min(np.abs(finer - edge)) > 0.5 * (even[1] - even[0])]
    edges = np.unique(np.concatenate([coarse, finer]))
    bins = len(edges) + 1
    index = np.searchsorted(edges, x, side="right")
    count = np.bincount(index, minlength=bins)
    kept = count >= 5
    means = [np.bincount(index, values, bins)[kept] / count[kept] for values in (x, y)]
    return means[0], means[1]
