# SPDX-License-Identifier: Apache-2.0
"""Selection of informative windows of long recordings: those that together cover most of the state space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.preprocessing.smoothing import kinematics
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

WINDOW = 10.0
"""Length of a window [s]."""
_SPEEDS = np.array([-0.1, -0.03, -0.01, -0.003, 0.003, 0.01, 0.03, 0.1])
"""Edges of the velocity bins [m/s]: finer where friction changes most."""
_OPENINGS = np.array([-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3])
"""Edges of the current bins, as shares of the largest current."""
_PLACES = np.linspace(0.0, 1.0, 17)[1:-1]
"""Edges of the bins of position (shares of the stroke) and of pressure difference (shares of the supply)."""
_TIMES = 10
"""Parts of the recordings that are distinguished, so that drift is seen."""
_THINNED = 5
"""Stride of the samples that are counted."""


class Visits:
    """Residence of each window: counts over cells of position by velocity and of current by pressures."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._cells: list[FloatArray] = []
        self._starts: list[float] = []

    def add(self, window: Segment) -> None:
        """Count one window."""
        channels, bench = window.channels, self._bench
        here: npt.NDArray[np.integer] = np.zeros(len(window), dtype=np.int64)
        there: npt.NDArray[np.integer] = np.zeros(len(window), dtype=np.int64)
        if "piston_position" in channels:
            position, velocity, _ = kinematics(channels["piston_position"], window.step, window.spacing)
            here = np.digitize(position / bench.stroke, _PLACES) * 9 + np.digitize(velocity, _SPEEDS)
        if "valve_current" in channels:
            there = np.digitize(channels["valve_current"] / bench.valve_current_max, _OPENINGS)
        if {"pressure_a", "pressure_b"} <= channels.keys():
            difference = channels["pressure_a"] - channels["pressure_b"]
            there = there + 9 * np.digitize(0.5 * (1.0 + difference / bench.supply_pressure), _PLACES)
        counts = [np.bincount(cells[::_THINNED], minlength=9 * 16) for cells in (here, there)]
        self._cells.append(np.concatenate(counts).astype(np.float64))
        self._starts.append(window.start)

    def counts(self) -> FloatArray:
        """Per window: samples in each cell, last those of its part of the length, shape (windows, cells)."""
        starts = np.array(self._starts)
        part = np.minimum((starts / max(float(starts.max()), 1e-9) * _TIMES).astype(np.int64), _TIMES - 1)
        cells = np.array(self._cells)
        return np.hstack([cells, np.eye(_TIMES)[part] * cells.sum(axis=1, keepdims=True) / 2.0])


def select_informative_windows(visits: Visits, count: int, among: Sequence[int] | None = None) -> list[int]:
    """Select at most `count` windows, each the one that most increases the sum of the roots of all cells' counts."""
    cells = visits.counts()
    open_ = list(range(len(cells)) if among is None else among)
    chosen: list[int] = []
    held = np.zeros(cells.shape[1])
    while open_ and len(chosen) < count:
        gains: npt.NDArray[np.float64] = np.sqrt(held + cells[open_]).sum(axis=1)
        chosen.append(open_.pop(int(np.argmax(gains))))
        held += cells[chosen[-1]]
    return sorted(chosen)
