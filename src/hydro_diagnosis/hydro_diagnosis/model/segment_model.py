# SPDX-License-Identifier: Apache-2.0
"""Residuals of a set of claims: the part of the recordings that the bench with these effects does not explain.

::

    pressure_a, pressure_b   innovations of a slow observer of the chamber equations, 120 ms of memory     1 kHz / 5
    motion                   f_h - (m x'' + b x' + dry friction + spring), weak form                        1 kHz / 5
    load                     f_l - what its sensor makes of the spring's force                               1 kHz / 5
    hydraulic                f_h - (A_p p_a - alpha A_p p_b), means over 100 ms: the slow part, which the
                             observer forgets; the fast part is in the other residuals already
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from scipy.ndimage import correlate1d

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, FloatArray, changes
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.forces import ForceBalance
from hydro_diagnosis.model.observer import ChamberObserver
from hydro_sim.model.equations import LOAD_CELL_DAMPING

PLACES = 4
"""Corrected positions that a segment keeps."""


class SegmentModel(ChamberObserver, ForceBalance):
    """A segment and its residuals under some claims, in physical units."""

    def placed(self, claims: Sequence[Claim]) -> SegmentModel:
        """The same segment with the position that is the piston's under these claims; itself, if it is the recorded."""
        moving = [claim for claim in claims if claim.effect.places]
        if not moving or not self.has_position:
            return self
        key = tuple((claim.effect.label, *claim.values.values()) for claim in moving)
        if key not in self._placed:
            channels = {**self.channels, "piston_position": self.true_signal("piston_position", moving)}
            while len(self._placed) >= PLACES:
                self._placed.pop(next(iter(self._placed)))
            self._placed[key] = SegmentModel(replace(self.segment, channels=channels), self.base, self)
        return self._placed[key]

    @cached_property
    def _placed(self) -> dict[tuple[Any, ...], SegmentModel]:
        return {}

    def pressure_residuals(self, run: ChamberRun) -> tuple[FloatArray, FloatArray]:
        """Pa, decimated."""
        a, b = (self.kept_smooth(innovation) for innovation in run.innovations)
        return a, b

    def motion_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, decimated, without the arc."""
        required = self.required_force(claims)
        if "hydraulic_force" in self.channels:
            return self._measured_force - self._shown_force(required, claims)
        bench = self.bench(claims)
        p_a, p_b = (self.true_signal("pressure_" + chamber, claims) for chamber in "ab")
        measured = bench.piston_area * (p_a - bench.area_ratio * p_b)
        return self.kept_smooth(measured) - self.kept_finish(required)

    @cached_property
    def _measured_force(self) -> FloatArray:
        return self.kept_smooth(self.channels["hydraulic_force"])

    def _shown_force(self, required: FloatArray, claims: Sequence[Claim]) -> FloatArray:
        """Reading [N] of the cell at the rod for a force, decimated."""
        if not any(changes(claim, "measure") for claim in claims):
            return self.kept_finish(required)
        return self.kept(self.reading("hydraulic_force", self.finish(required), claims, smoothed=True))

    def arc_residual(self, run: ChamberRun) -> FloatArray:
        """N, decimated: by how much the mean of f_h around each sample exceeds the sample.

        Straight lines between the samples (second differences over 12), and the arcs upon them.
        """
        return self.kept_smooth(run.arc) + self._lines_arc

    @cached_property
    def _lines_arc(self) -> FloatArray:
        """N, decimated: what straight lines between the samples of f_h exceed them by."""
        bench, channels = self.base, self.channels
        force = channels.get("hydraulic_force")
        if force is None:
            force = bench.piston_area * (channels["pressure_a"] - bench.area_ratio * channels["pressure_b"])
        return self.kept_smooth(correlate1d(force, (1.0 / 12.0, -2.0 / 12.0, 1.0 / 12.0), mode="nearest"))

    def load_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, decimated."""
        bench = self.bench(claims)
        force = self.spring_force(bench, claims, self.recorded)
        if bench.load_cell_bandwidth is not None:
            force = self.memory.low_pass("load_force", force, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
        return self.kept_smooth(self.channels["load_force"] - self.reading("load_force", force, claims))

    def hydraulic_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, means over blocks. A pressure sensor's lag is not undone: everything else is delayed alike."""
        bench = self.bench(claims)
        late = [one for one in claims if one.effect.rounds.startswith("pressure") and not one.effect.turns]
        others = [claim for claim in claims if claim not in late]

        def delayed(signal: FloatArray, but: str) -> FloatArray:
            for claim in late:
                if claim.effect.rounds != but:
                    signal = claim.effect.measure(claim.effect.rounds, signal, self.memory, claim.values)
            return signal

        channels = ("pressure_a", "pressure_b")
        p_a, p_b = (delayed(self.true_signal(channel, others), channel) for channel in channels)
        force = bench.piston_area * (p_a - bench.area_ratio * p_b)
        off = delayed(self.channels["hydraulic_force"], "") - self.reading("hydraulic_force", force, others)
        return self.means(off)


BLOCKS = {PRESSURE: ("pressure_a", "pressure_b"), MOTION: ("motion",), LOAD: ("load",), HYDRAULIC: ("hydraulic",)}
"""Channels of residuals in each block."""
