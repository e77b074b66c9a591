# SPDX-License-Identifier: Apache-2.0
"""Valve characteristic from the recordings: the current that an ideal valve would have needed for the flow."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report.plots import binned, svg
from hydro_sim.plotting import BLUE, GRAY, ORANGE, legend

STATIC = ("valve_deadband", "valve_offset", "valve_gain", "valve_gain_asymmetry", "valve_null_leakage")
"""Effects that change the characteristic itself."""
_WIDTH = 4.0
"""Samples, of the Gaussian behind the rate of pressure."""
_ZOOM = {"valve_deadband": 4.0, "valve_offset": 8.0, "valve_null_leakage": 4.0}
"""Plotted range around null by effect, in multiples of its width; others are shown over the whole range."""


def valve_plot(found: Diagnosis, claim: Claim) -> str:
    """Flow into chamber A over valve current: recorded, fitted and of the bench file, as an ideal valve's current."""
    claims = (*found.problem.baseline, *found.assessment.fit.claims)
    looks = [_looked(model, claims) for model in found.problem.models]
    current, recorded, fitted = (np.concatenate(parts) for parts in zip(*looks, strict=True))
    reach = float(np.percentile(np.abs(current), 99.5))
    if claim.effect.id in _ZOOM:
        size = max(abs(claim.values[key]) for key in claim.values if key in _WIDTHS)
        reach = min(reach, _ZOOM[claim.effect.id] * size)
    near = np.abs(current) <= reach
    current, recorded, fitted = current[near], recorded[near], fitted[near]

    def draw(axes: Any) -> None:
        some = np.random.default_rng(0).permutation(len(current))[:4000]
        shown = {"markersize": 1.5, "alpha": 0.5, "label": "recorded"}
        axes[0].plot(1e3 * current[some], 1e3 * recorded[some], ".", color=GRAY, **shown)
        axes[0].plot(*(1e3 * part for part in binned(current, recorded)), "o", color=ORANGE, markersize=3, label="mean")
        axes[0].plot(*(1e3 * part for part in binned(current, fitted)), color=BLUE, label="with the effects found")
        axes[0].plot([-1e3 * reach, 1e3 * reach], [-1e3 * reach, 1e3 * reach], ":", color="black", label="ideal valve")
        low, high = np.percentile(recorded, [2.0, 98.0])
        axes[0].set_ylim(2e3 * min(low, -reach / 2), 2e3 * max(high, reach / 2))
        axes[0].set_xlabel("valve current [mA]")
        axes[0].set_ylabel("flow into A, as an\nideal valve's current [mA]")
        legend(axes[0])

    return svg(1, (8.0, 3.4), draw)


_WIDTHS = ("half_width", "half_width_negative", "current", "width")


def _looked(model: SegmentModel, claims: tuple[Claim, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Valve current, and what an ideal valve would have needed for the recorded and for the fitted flow into A [A]."""
    bench, oil = model.bench(claims), model.oil(claims)
    stiff, _ = chambers.compliances(bench, oil, claims)
    pressure = gaussian_filter1d(oil.pressures[0], _WIDTH, order=1, mode="nearest") / model.step
    flow = pressure / stiff + bench.piston_area * gaussian_filter1d(model.v, _WIDTH)
    into_a, _ = chambers.net_flows(bench, oil, claims, model.memory)
    kept = slice(model.settle, len(flow) - 20)
    currents = []
    for signal in (flow, gaussian_filter1d(into_a, _WIDTH)):
        drop = np.where(signal >= 0.0, bench.supply_pressure - oil.pressures[0], oil.pressures[0] - bench.tank_pressure)
        currents.append(signal / (model.bench(()).valve_gain * np.sqrt(np.maximum(drop, 1e5))))
    return gaussian_filter1d(model.channels["valve_current"], _WIDTH)[kept], currents[0][kept], currents[1][kept]
