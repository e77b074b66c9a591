# SPDX-License-Identifier: Apache-2.0
"""From a set of claims to residuals: what of the recordings the bench with these effects does not account for.

::

    pressure_a, pressure_b   innovations of a slow observer of the chamber equations, 120 ms of memory     1 kHz / 5
    motion                   f_h - (m x'' + b x' + dry friction + spring), weak form                        1 kHz / 5
    load                     f_l - what its sensor makes of the spring's force                               1 kHz / 5
    hydraulic                f_h - (A_p p_a - alpha A_p p_b), means over 100 ms: the slow part, which the
                             observer forgets; the fast part is in the other residuals already
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from scipy.signal import lfilter

from hydro_diagnosis import chambers
from hydro_diagnosis.chambers import ChamberRun, Oil
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, Effect, FloatArray, Kinematics
from hydro_diagnosis.effects.friction import SLIP_VELOCITY
from hydro_diagnosis.memory import RecordMemory
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.smoothing import KINEMATIC_WIDTH, STRIDE, finish, kinematics, smooth
from hydro_sim.bench import LOAD_CELL_DAMPING, Bench

Kept = TypeVar("Kept")
SHELF = 8
"""Intermediate results that a segment keeps at most."""
HASTENED = 3
"""Rounds in which pressures behind lagging sensors and the flows that they drive are brought together."""
OBSERVER_MEMORY = 0.12
"""s. A shorter memory forgets the slow drift that a small leak builds up."""
BLOCK = 100
"""Samples per mean of the hydraulic balance."""
VELOCITY_DOUBT = 1e-3
"""m/s, to which the velocity's zero is known."""
TIMING_DOUBT = 3e-6
"""s, to which the equations, integrated sample by sample, and the sensors agree on when something happened."""
_GAUSS_HERMITE = ((-(3.0**0.5), 1.0 / 6.0), (0.0, 2.0 / 3.0), (3.0**0.5, 1.0 / 6.0))
SETTLE = 0.3
"""s at the start of a segment that are not judged: filters and observer settle."""


class SegmentModel:
    """A segment with everything that does not depend on the claims computed once."""

    def __init__(self, segment: Segment, bench: Bench) -> None:
        self.segment = segment
        self._bench = bench
        self.step = segment.step
        self.time = segment.time
        self.memory = RecordMemory(segment.step)
        channels = segment.channels
        self.channels = channels
        self._shelf: dict[tuple[Any, ...], Any] = {}
        self.has_position = "piston_position" in channels
        self.has_pressures = {"pressure_a", "pressure_b"} <= channels.keys()
        self.settle = min(round(SETTLE / self.step), len(segment) // 4)
        if self.has_position:
            self.x, self.v, self.a = kinematics(channels["piston_position"], self.step)
            self.kinematics = Kinematics(self.time, self.x, self.v)
            self.recorded = Kinematics(self.time, channels["piston_position"], self.v)

    def bench(self, claims: Sequence[Claim]) -> Bench:
        """The bench with the values that the claims replace."""
        bench = self._bench
        for claim in claims:
            bench = claim.effect.bench(bench, claim.values)
        return bench

    # -- chambers ---------------------------------------------------------------------------------------------------

    def true_signal(self, channel: str, claims: Sequence[Claim]) -> FloatArray:
        """A channel with the sensors' gains and biases taken out."""
        signal = self.channels[channel]
        for claim in claims:
            signal = claim.effect.unmeasure(channel, signal, self.memory, claim.values)
        return signal

    def reading(self, channel: str, signal: FloatArray, claims: Sequence[Claim]) -> FloatArray:
        """What a channel's sensor shows of a true signal."""
        for claim in claims:
            signal = claim.effect.measure(channel, signal, self.memory, claim.values)
        return signal

    def oil(self, claims: Sequence[Claim]) -> Oil:
        """Middle of each sample interval: the last interval repeats, so that lengths stay n."""
        moving = [claim for claim in claims if chambers.moves_spool(claim)]
        sensing = [claim for claim in claims if type(claim.effect).unmeasure is not Effect.unmeasure]
        spool = self._kept_back("spool", moving, self._spool)
        p_a, p_b = self._kept_back("pressures", sensing, self._middle_pressures)
        position = self._kept_back("position", (), self._middle_position)
        return Oil(self.time, position, (p_a, p_b), spool)

    def _spool(self, claims: Sequence[Claim]) -> FloatArray:
        return chambers.spool_position(self.channels["valve_current"], self.step / chambers.SUBSTEPS, claims)

    def _middle_pressures(self, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray]:
        p_a, p_b = (chambers.middle(self.true_signal("pressure_" + chamber, claims)) for chamber in "ab")
        return p_a, p_b

    def _middle_position(self, claims: Sequence[Claim]) -> FloatArray:
        return chambers.middle(self.channels["piston_position"])

    def _kept_back(self, what: str, claims: Sequence[Claim], compute: Callable[[Sequence[Claim]], Kept]) -> Kept:
        """What these claims make, computed once as long as only others change."""
        key = (what, *((claim.effect.label, *claim.values.values()) for claim in claims))
        if key not in self._shelf:
            if len(self._shelf) >= SHELF:
                self._shelf.pop(next(iter(self._shelf)))
            self._shelf[key] = compute(claims)
        found: Kept = self._shelf[key]
        return found

    def chamber_run(self, claims: Sequence[Claim]) -> ChamberRun:
        """Innovations and arcs under the claims."""
        bench = self.bench(claims)
        oil = self.oil(claims)
        stiff, (built_a, built_b) = self._built(bench, oil, claims)
        lagging = any(claim.effect.rounds.startswith("pressure") for claim in claims)
        for _ in range(HASTENED if lagging else 0):
            oil = self._hastened(oil, (built_a, built_b), claims)
            stiff, (built_a, built_b) = self._built(bench, oil, claims)
        innovations = tuple(
            self._innovation(channel, built, claims)
            for channel, built in (("pressure_a", built_a), ("pressure_b", built_b))
        )
        force = bench.piston_area * (built_a - bench.area_ratio * built_b)
        arc = chambers.force_arc(bench, oil, stiff, self.a, self.step)
        return ChamberRun((innovations[0], innovations[1]), arc, force)

    def _built(
        self, bench: Bench, oil: Oil, claims: Sequence[Claim]
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """beta/V [Pa/m3] of both chambers, and the pressure [Pa] that each sample builds in them."""
        into_a, into_b = chambers.net_flows(bench, oil, claims, self.memory)
        stiff_a, stiff_b = chambers.compliances(bench, oil, claims)
        position = self.channels["piston_position"]
        swept = bench.piston_area * np.diff(position, append=position[-1])
        built_a = stiff_a * (into_a * self.step - swept)
        built_b = stiff_b * (into_b * self.step + bench.area_ratio * swept)
        return (stiff_a, stiff_b), (built_a, built_b)

    def _hastened(self, oil: Oil, built: tuple[FloatArray, FloatArray], claims: Sequence[Claim]) -> Oil:
        """The oil with pressures behind lagging sensors: what the lag swallows is taken from the pressure built."""
        others = [claim for claim in claims if not claim.effect.rounds.startswith("pressure")]
        pressures = list(oil.pressures)
        for index, channel in enumerate(("pressure_a", "pressure_b")):
            late = [claim for claim in claims if claim.effect.rounds == channel]
            if late:
                integral = np.concatenate([[0.0], np.cumsum(built[index][:-1])])
                swallowed = integral - self.reading(channel, integral, late)
                pressures[index] = chambers.middle(self.true_signal(channel, others) + swallowed)
        return Oil(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool)

    def _innovation(self, channel: str, built: FloatArray, claims: Sequence[Claim]) -> FloatArray:
        integral = np.concatenate([[0.0], np.cumsum(built[:-1])])
        unexplained = self.channels[channel] - self.reading(channel, integral, claims)
        gain = self.step / OBSERVER_MEMORY
        start = float(np.mean(unexplained[:10]))
        followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], unexplained, zi=[start])
        return unexplained - np.asarray(followed)

    # -- forces -----------------------------------------------------------------------------------------------------

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

    def timing_doubt(self) -> FloatArray:
        """Standard deviation [Pa] of the pressures, because displacement and flow are only so well timed, decimated."""
        bench = self._bench
        per_meter = bench.bulk_modulus * bench.piston_area / bench.dead_volume_a
        return per_meter * TIMING_DOUBT * self._kept(smooth(np.abs(self.v)))

    # -- residuals, in physical units -------------------------------------------------------------------------------

    def pressure_residuals(self, run: ChamberRun) -> tuple[FloatArray, FloatArray]:
        """Pa, decimated."""
        a, b = (self._kept(smooth(innovation)) for innovation in run.innovations)
        return a, b

    def motion_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, decimated, without the arc."""
        if "hydraulic_force" in self.channels:
            measured = self.channels["hydraulic_force"]
            needed = self.reading("hydraulic_force", self.force_on_rod(claims), claims)
        else:
            bench = self.bench(claims)
            p_a, p_b = (self.true_signal("pressure_" + chamber, claims) for chamber in "ab")
            measured = bench.piston_area * (p_a - bench.area_ratio * p_b)
            needed = self.force_on_rod(claims)
        return self._kept(smooth(measured) - needed)

    def arc_residual(self, run: ChamberRun) -> FloatArray:
        """N, decimated: what the arcs add to the motion residual."""
        return self._kept(smooth(run.arc))

    def load_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, decimated."""
        bench = self.bench(claims)
        force = self.spring_force(bench, claims, self.recorded)
        if bench.load_cell_bandwidth is not None:
            force = self.memory.low_pass("load_force", force, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
        return self._kept(smooth(self.channels["load_force"] - self.reading("load_force", force, claims)))

    def hydraulic_residual(self, claims: Sequence[Claim]) -> FloatArray:
        """N, means over blocks. A pressure sensor's lag is not undone: everything else is delayed alike."""
        bench = self.bench(claims)
        late = [claim for claim in claims if claim.effect.rounds.startswith("pressure")]
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
        off = off[self.settle :]
        return off[: len(off) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)

    def _kept(self, signal: FloatArray) -> FloatArray:
        return signal[self.settle : len(signal) - 20 : STRIDE]

    def kept_time(self) -> FloatArray:
        """s, of the decimated residuals."""
        return self._kept(self.time)

    def block_time(self) -> FloatArray:
        """s, of the means over blocks."""
        count = (len(self.time) - self.settle) // BLOCK
        return self.time[self.settle] + (np.arange(count) + 0.5) * BLOCK * self.step


BLOCKS = {PRESSURE: ("pressure_a", "pressure_b"), MOTION: ("motion",), LOAD: ("load",), HYDRAULIC: ("hydraulic",)}
"""Channels of residuals in each block."""
