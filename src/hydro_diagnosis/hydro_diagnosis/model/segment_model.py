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

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d, distance_transform_edt
from scipy.special import ndtr

from hydro_diagnosis.effects.base import (
    HYDRAULIC,
    LOAD,
    MOTION,
    PRESSURE,
    Claim,
    FloatArray,
    Kinematics,
    Pair,
    changes,
    values_key,
)
from hydro_diagnosis.effects.friction import SLIP_VELOCITY
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.segment_record import BoundedCache, ChamberObserver, SegmentRecord
from hydro_diagnosis.preprocessing.smoothing import KINEMATIC_WIDTH
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

VELOCITY_UNCERTAINTY = 1e-3
"""Uncertainty [m/s] of the velocity's zero."""
SLIDING = 3.0 * VELOCITY_UNCERTAINTY
"""Speed [m/s] from which on the direction of motion is known."""
_FAST = 1.0
"""Velocity [m/s] beyond which friction is that of sliding."""
_GAUSS_HERMITE = ((-(3.0**0.5), 1.0 / 6.0), (0.0, 2.0 / 3.0), (3.0**0.5, 1.0 / 6.0))
PLACES = 4
"""Corrected positions that a segment keeps."""


class SegmentModel(SegmentRecord):
    """A segment, the forces on its mass, and its residuals under some claims, in physical units."""

    def __init__(self, segment: Segment, bench: Bench, like: SegmentRecord | None = None) -> None:
        super().__init__(segment, bench, like)
        self.observer = ChamberObserver(self)
        self._placed = BoundedCache(PLACES)

    def dry_friction_level(self, claims: Sequence[Claim], velocity: FloatArray | None = None) -> FloatArray:
        """Level [N] of dry friction while sliding."""
        motion = self.kinematics if velocity is None else Kinematics(self.time, self.x, velocity)
        level = np.zeros_like(self.x)
        for claim in claims:
            level = claim.effect.drag(level, motion, claim.values)
        return level

    def spring_force(self, bench: Bench, claims: Sequence[Claim], motion: Kinematics) -> FloatArray:
        """True force [N] of the load."""
        force = bench.spring_stiffness * (motion.position - bench.spring_rest_position)
        for claim in claims:
            force = claim.effect.load(force, motion, bench, self.memory, claim.values)
        return force

    def dry_friction(self, claims: Sequence[Claim]) -> FloatArray:
        """Dry friction [N] without bristles, as the first Gaussian sees it: a mean over velocities where they change.

        Friction is no straight line in the velocity. Taken at the smoothed velocity alone, a Stribeck rise that the
        piston passes within milliseconds would read a quarter too small.
        """
        force = np.zeros_like(self.x)
        dry = any(changes(claim, "drag") for claim in claims)
        if not dry or any(claim.effect.bristles for claim in claims):
            return force
        for weight, velocity, sign in self._seen_velocities:
            force += weight * self.dry_friction_level(claims, velocity) * sign
        return force

    @cached_property
    def _seen_velocities(self) -> tuple[tuple[float, FloatArray, FloatArray], ...]:
        """Weight, velocity [m/s] and its smoothed sign at each node of the first Gaussian."""
        width = KINEMATIC_WIDTH * self.spacing * self.step
        nodes = ((weight, self.v + node * width * self.a) for node, weight in _GAUSS_HERMITE)
        return tuple((weight, velocity, np.tanh(velocity / SLIP_VELOCITY)) for weight, velocity in nodes)

    def required_force(self, claims: Sequence[Claim]) -> FloatArray:
        """Hydraulic force [N] that the recorded motion needs, as the first Gaussian sees it."""
        bench = self.bench(claims)
        force = self.dry_friction(claims)
        resisting = [claim for claim in claims if changes(claim, "resistance")]
        level = self.dry_friction_level(claims) if resisting else force
        for claim in resisting:
            force = claim.effect.resistance(force, level, self.kinematics, self.memory, claim.values)
        inertia = bench.moving_mass * self.a + bench.viscous_friction * self.v
        return inertia + force + self.spring_force(bench, claims, self.kinematics)

    def friction_uncertainty(self, claims: Sequence[Claim], reversals: int = 1) -> FloatArray:
        """Standard deviation [N] of the dry friction, because the velocity near standstill is only known so well.

        `reversals`: of all recordings; the same kernel misplaces the velocity alike at each of them, which does not
        average out: its doubt is that of their mean, not of one.
        """
        level = self.dry_friction_level(claims)
        doubt = self._swing(
            claims, VELOCITY_UNCERTAINTY + 0.5 * np.abs(self.a) * self.spacing * self.step, np.zeros_like(level)
        )
        beyond = self.dry_friction_level(claims, np.full_like(self.v, _FAST))
        if not any(claim.effect.bristles for claim in claims):  # bristles build their force up: nothing jumps
            doubt = np.hypot(doubt, np.sqrt(reversals) * self._swing(claims, self.velocity_kink(claims), beyond))
        late = [claim for claim in claims if claim.effect.lagged == "hydraulic_force"]
        return self.smooth(np.abs(self.reading("hydraulic_force", doubt, late)))

    def velocity_kink(self, claims: Sequence[Claim]) -> FloatArray:
        """By how much [m/s] the first Gaussian misplaces a velocity whose slope jumps where the piston reverses.

        Dry friction F turns round there, so x_p'' jumps by 2 F / m. A kink of slope J seen through a Gaussian of width
        s is off by J s (phi(u) - |u| Phi(-|u|)), at |u| widths from it.
        """
        at_rest = self.dry_friction_level(claims, np.zeros_like(self.v))
        width = KINEMATIC_WIDTH * self.spacing * self.step
        jump = 2.0 * at_rest / self.bench(claims).moving_mass
        u = self._since_rest / (KINEMATIC_WIDTH * self.spacing)
        return jump * width * (np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi) - u * ndtr(-u))

    @cached_property
    def reversals(self) -> int:
        """Number of times that the piston comes to a stand or reverses; what an encoder shows at rest is none."""
        marks = np.where(self._resting, 1, 0) - np.where(~self._resting & (np.abs(self.v) > SLIDING), 1, 0)
        return int(np.count_nonzero(np.diff(marks[marks != 0], prepend=-1) == 2))

    @cached_property
    def _resting(self) -> npt.NDArray[np.bool_]:
        resting = np.abs(self.v) < VELOCITY_UNCERTAINTY
        turns = self.v[:-1] * self.v[1:] <= 0.0
        resting[:-1] |= turns
        resting[1:] |= turns
        return resting

    @cached_property
    def _since_rest(self) -> FloatArray:
        """Samples to the nearest one at which the piston stands or turns round."""
        if not self._resting.any():
            return np.full_like(self.v, len(self.v))
        return np.asarray(distance_transform_edt(~self._resting))

    def _swing(self, claims: Sequence[Claim], velocity: FloatArray, but: FloatArray) -> FloatArray:
        """Half of how far dry friction beyond a level `but` [N] changes between -/+ `velocity` around the recorded."""
        low, high = (
            (self.dry_friction_level(claims, one) - but) * np.tanh(one / VELOCITY_UNCERTAINTY)
            for one in (self.v - velocity, self.v + velocity)
        )
        return np.asarray(np.abs(high - low) / 2.0)

    def variable(self, name: str) -> FloatArray:
        """A variable that a hidden input may depend on, shape (n,), SI units."""
        if name == "time":
            return self.time
        if name == "position":
            return self.x
        if name == "velocity":
            return self.v
        if name == "current":
            return self.channels["valve_current"]
        if name == "pressure_difference":
            return self.smooth(self.channels["pressure_a"] - self.channels["pressure_b"])
        return self.smooth(self.channels[name])

    def placed(self, claims: Sequence[Claim]) -> SegmentModel:
        """The same segment with the position that is the piston's under these claims; itself, if it is the recorded."""
        moving = [claim for claim in claims if claim.effect.places]
        if not moving or not self.has_position:
            return self

        def moved() -> SegmentModel:
            channels = {**self.channels, "piston_position": self.true_signal("piston_position", moving)}
            return SegmentModel(replace(self.segment, channels=channels), self.base, self)

        return self._placed.kept(values_key(moving), moved)

    def pressure_residuals(self, run: ChamberRun) -> Pair:
        """Pa, decimated."""
        a, b = (self.kept_smooth(innovation) for innovation in run.innovations)
        return a, b

    def motion_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, decimated, without the arc."""
        required = self.required_force(claims)
        if "hydraulic_force" in self.channels:
            return self._cell_force - self._shown_force(required, claims)
        return self.measured_force(claims) - self.kept_finish(required)

    def measured_force(self, claims: Sequence[Claim]) -> FloatArray:
        """Hydraulic force [N] of the cell, or else of the pressures, decimated."""
        if "hydraulic_force" in self.channels:
            return self._cell_force
        bench = self.bench(claims)
        p_a, p_b = (self.true_signal("pressure_" + chamber, claims) for chamber in "ab")
        return self.kept_smooth(bench.piston_area * (p_a - bench.area_ratio * p_b))

    @cached_property
    def _cell_force(self) -> FloatArray:
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
        force = self.behind_cell(self.spring_force(bench, claims, self.recorded), bench)
        return self.kept_smooth(self.channels["load_force"] - self.reading("load_force", force, claims))

    def hydraulic_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, means over blocks. A pressure sensor's lag is not undone: everything else is delayed alike."""
        bench = self.bench(claims)
        late = [one for one in claims if one.effect.lagged.startswith("pressure") and not one.effect.asymmetric]
        others = [claim for claim in claims if claim not in late]

        def delayed(signal: FloatArray, but: str) -> FloatArray:
            for claim in late:
                if claim.effect.lagged != but:
                    signal = claim.effect.measure(claim.effect.lagged, signal, self.memory, claim.values)
            return signal

        channels = ("pressure_a", "pressure_b")
        p_a, p_b = (delayed(self.true_signal(channel, others), channel) for channel in channels)
        force = bench.piston_area * (p_a - bench.area_ratio * p_b)
        off = delayed(self.channels["hydraulic_force"], "") - self.reading("hydraulic_force", force, others)
        return self.means(off)


BLOCKS = {PRESSURE: ("pressure_a", "pressure_b"), MOTION: ("motion",), LOAD: ("load",), HYDRAULIC: ("hydraulic",)}
"""Channels of residuals in each block."""
