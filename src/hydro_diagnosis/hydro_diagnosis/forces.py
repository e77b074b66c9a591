# SPDX-License-Identifier: Apache-2.0
"""The force that the recorded motion needs: inertia, friction, load; and how far its friction can be trusted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray, Kinematics
from hydro_diagnosis.effects.friction import SLIP_VELOCITY
from hydro_diagnosis.segment_record import SegmentRecord
from hydro_diagnosis.smoothing import KINEMATIC_WIDTH, finish, smooth
from hydro_sim.bench import Bench

VELOCITY_DOUBT = 1e-3
"""m/s, to which the velocity's zero is known."""
_GAUSS_HERMITE = ((-(3.0**0.5), 1.0 / 6.0), (0.0, 2.0 / 3.0), (3.0**0.5, 1.0 / 6.0))


class ForceBalance(SegmentRecord):
    """Forces on the moving mass under some claims, from the recorded position."""

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
        if any(claim.effect.bristles for claim in claims):
            return force
        for node, weight in _GAUSS_HERMITE:
            velocity = self.v + node * KINEMATIC_WIDTH * self.step * self.a
            force += weight * self.dry_friction_level(claims, velocity) * np.tanh(velocity / SLIP_VELOCITY)
        return force

    def force_on_rod(self, claims: Sequence[Claim]) -> FloatArray:
        """Hydraulic force [N] that the recorded motion needs, at the total width."""
        bench = self.bench(claims)
        level = self.dry_friction_level(claims)
        force = self.dry_friction(claims)
        for claim in claims:
            force = claim.effect.resistance(force, level, self.kinematics, self.memory, claim.values)
        inertia = bench.moving_mass * self.a + bench.viscous_friction * self.v
        return finish(inertia + force + self.spring_force(bench, claims, self.kinematics))

    def friction_doubt(self, claims: Sequence[Claim]) -> FloatArray:
        """Standard deviation [N] of the dry friction, because the velocity's zero is only known so well."""
        doubt = VELOCITY_DOUBT + 0.5 * np.abs(self.a) * self.step
        sides = []
        for velocity in (self.v - doubt, self.v + doubt):
            sides.append(self.dry_friction_level(claims, velocity) * np.tanh(velocity / VELOCITY_DOUBT))
        late = [claim for claim in claims if claim.effect.rounds == "hydraulic_force"]
        return smooth(np.abs(self.reading("hydraulic_force", np.abs(sides[1] - sides[0]) / 2.0, late)))
