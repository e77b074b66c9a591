# SPDX-License-Identifier: Apache-2.0
"""Quantities of a segment that do not depend on claims, and the sensor models of its channels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray, Kinematics
from hydro_diagnosis.model.memory import RecordMemory
from hydro_diagnosis.preprocessing.box_clock import Rows, judged
from hydro_diagnosis.preprocessing.smoothing import STRIDE, bend, finish, finish_at, kinematics, smooth, smooth_at
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

BLOCK = 0.1
"""Averaging time [s] of the hydraulic balance."""
TAIL = 20
"""Recorded rows at a segment's end that are not judged, and `MARGIN` before and after one that is missing."""
MARGIN = 6
SETTLE = 0.3
"""Time [s] at the start of a segment that is not judged: filters and observer settle."""


class SegmentRecord:
    """A segment, the bench that is believed, and the piston's smoothed motion.

    `like`: the same stretch with more rows, whose judged samples are judged here too.
    """

    def __init__(self, segment: Segment, bench: Bench, like: SegmentRecord | None = None) -> None:
        self.segment = segment
        self.base = bench
        """The bench as believed, no claim written into it."""
        self.step = segment.step
        self.spacing = segment.spacing
        self.time = segment.time
        channels = segment.channels
        self.channels = channels
        self.has_position = "piston_position" in channels
        self.has_pressures = {"pressure_a", "pressure_b"} <= channels.keys()
        self.settle = min(round(SETTLE / self.step), len(segment) // 4)
        end = len(segment) - TAIL * self.spacing
        self.rows: Rows | slice = like.rows if like else judged(segment, self.settle, end, STRIDE, MARGIN)
        """Samples that are judged."""
        self._judged = np.arange(len(segment))[self.rows]
        if self.has_position:
            self.x, self.v, self.a = kinematics(channels["piston_position"], self.step, self.spacing)
            pressures = (channels["pressure_a"], channels["pressure_b"]) if self.has_pressures else None
            self.kinematics = Kinematics(self.time, self.x, self.v, pressures, self.a)
            bent = bend(channels["piston_position"], self.step)
            self.recorded = Kinematics(self.time, channels["piston_position"], self.v, None, bent)
        self.beside = self._beside()
        """What stands beside a sensor that is read, shape (n,) each."""
        self.memory = RecordMemory(segment.step, self.beside)

    def _beside(self) -> dict[str, FloatArray]:
        """A reading is taken under the current that was held until then."""
        found = {name: self.channels[name] for name in ("pressure_a", "pressure_b") if name in self.channels}
        if self.has_position:
            found |= {"position": self.channels["piston_position"], "velocity": self.v, "acceleration": self.a}
        if "valve_current" in self.channels:
            current = self.channels["valve_current"]
            found["current"] = np.concatenate([current[:1], current[:-1]])
        return found

    def bench(self, claims: Sequence[Claim]) -> Bench:
        """The bench with the values that the claims replace."""
        bench = self.base
        for claim in claims:
            bench = claim.effect.bench(bench, claim.values)
        return bench

    def true_signal(self, channel: str, claims: Sequence[Claim]) -> FloatArray:
        """A channel with the sensors' gains and biases taken out."""
        signal = self.channels[channel]
        for claim in claims:
            signal = claim.effect.unmeasure(channel, signal, self.memory, claim.values)
        return signal

    def reading(self, channel: str, signal: FloatArray, claims: Sequence[Claim], smoothed: bool = False) -> FloatArray:
        """Return the reading of a channel's sensor for a true signal; `smoothed`: through the test function."""
        self.memory.beside = self._smooth_beside if smoothed else self.beside
        for claim in claims:
            signal = claim.effect.measure(channel, signal, self.memory, claim.values)
        self.memory.beside = self.beside
        return signal

    @cached_property
    def _smooth_beside(self) -> dict[str, FloatArray]:
        smoothed = {name: self.smooth(signal) for name, signal in self.beside.items() if name != "acceleration"}
        return smoothed | ({"acceleration": self.finish(self.a)} if self.has_position else {})

    def kept(self, signal: FloatArray) -> FloatArray:
        """Return the judged part of a signal, shape (n,): settled, and every fifth recorded row."""
        return signal[self.rows]

    def smooth(self, signal: FloatArray) -> FloatArray:
        """A measured signal through the test function, shape (n,)."""
        return smooth(signal, self.spacing)

    def finish(self, signal: FloatArray) -> FloatArray:
        """Smooth a result of the smoothed motion to the test function's width, shape (n,)."""
        return finish(signal, self.spacing)

    def kept_smooth(self, signal: FloatArray) -> FloatArray:
        """`smooth` at the judged samples alone."""
        return smooth_at(signal, self._judged, self.spacing)

    def kept_finish(self, signal: FloatArray) -> FloatArray:
        """`finish` at the judged samples alone."""
        return finish_at(signal, self._judged, self.spacing)

    def means(self, signal: FloatArray) -> FloatArray:
        """Means over blocks of `BLOCK` of a settled signal."""
        length, settled = round(BLOCK / self.step), signal[self.settle :]
        return settled[: len(settled) // length * length].reshape(-1, length).mean(axis=1)

    def kept_time(self) -> FloatArray:
        """s, of the decimated residuals."""
        return self.kept(self.time)

    def block_time(self) -> FloatArray:
        """s, of the means over blocks."""
        length = round(BLOCK / self.step)
        count = (len(self.time) - self.settle) // length
        return self.time[self.settle] + (np.arange(count) + 0.5) * length * self.step
