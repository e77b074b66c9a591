# SPDX-License-Identifier: Apache-2.0
"""Chamber equations along a segment: the pressures that they build, and the innovations of a slow observer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import Claim, FloatArray, Oil, changes
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.segment_record import SegmentRecord
from hydro_diagnosis.preprocessing.smoothing import white_noise
from hydro_diagnosis.recording import Segment
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench

Kept = TypeVar("Kept")
SHELF = 10
"""Largest number of intermediate results that a segment keeps."""
HASTENED = 3
"""Iterations between the pressures behind lagging sensors and the flows that they drive."""
OBSERVER_MEMORY = 0.12
"""Memory [s] of the observer. A shorter one forgets the slow drift that a small leak builds up."""
SLOPE_STEP = 1e3
"""Step [Pa] of the differences that give the slope of a curved reading."""
TIMING_DOUBT = 3e-6
"""Timing uncertainty [s] between the equations, integrated sample by sample, and the sensors."""


class ChamberObserver(SegmentRecord):
    """Both chambers under some claims, from recorded current, position and pressures."""

    def __init__(self, segment: Segment, bench: Bench, like: SegmentRecord | None = None) -> None:
        super().__init__(segment, bench, like)
        self._shelf: dict[tuple[Any, ...], Any] = {}

    def oil(self, claims: Sequence[Claim]) -> Oil:
        """Middle of each sample interval: the last interval repeats, so that lengths stay n."""
        moving = sorted(filter(chambers.moves_spool, claims), key=lambda claim: claim.effect.stage)
        sensing = [claim for claim in claims if changes(claim, "unmeasure")]
        spool = self._kept_back("spool", moving, self._spool)
        p_a, p_b = self._kept_back("pressures", sensing, self._middle_pressures)
        position = self._kept_back("position", (), self._middle_position)
        velocity = self._kept_back("velocity", (), lambda claims: chambers.middle(self.v))
        return Oil(self.time, position, (p_a, p_b), spool, velocity)

    def _spool(self, claims: Sequence[Claim]) -> FloatArray:
        """Each claim's spool is kept back, so that what comes later in the command's path begins there."""
        if not claims:
            return chambers.spool_position(self.channels["valve_current"], self.step / chambers.SUBSTEPS, ())
        *before, last = claims
        spool = self._kept_back("spool", before, self._spool) if before else self._held_current
        return last.effect.command(spool, self.step / chambers.SUBSTEPS, last.values)

    @cached_property
    def _held_current(self) -> FloatArray:
        """A, shape (n, substeps)."""
        return np.repeat(self.channels["valve_current"][:, None], chambers.SUBSTEPS, axis=1)

    def _middle_pressures(self, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray]:
        p_a, p_b = (chambers.middle(self.true_signal("pressure_" + chamber, claims)) for chamber in "ab")
        return p_a, p_b

    def _middle_position(self, claims: Sequence[Claim]) -> FloatArray:
        return chambers.middle(self.channels["piston_position"])

    def _kept_back(self, what: str, claims: Sequence[Claim], compute: Callable[[Sequence[Claim]], Kept]) -> Kept:
        """Return the result for these claims, computed once as long as only others change."""
        key = (what, *((claim.effect.label, *claim.values.values()) for claim in claims))
        found: Kept = self._shelf.pop(key) if key in self._shelf else compute(claims)
        if len(self._shelf) >= SHELF:
            self._shelf.pop(next(iter(self._shelf)))
        self._shelf[key] = found  # the one that was asked for longest ago goes first
        return found

    def chamber_run(self, claims: Sequence[Claim]) -> ChamberRun:
        """Innovations and arcs under the claims."""
        bench = self.bench(claims)
        oil = self.oil(claims)
        stiff, (built_a, built_b) = self.built(bench, oil, claims)
        lagging = any(claim.effect.rounds.startswith("pressure") for claim in claims)
        for _ in range(HASTENED if lagging else 0):
            oil = self._hastened(oil, (built_a, built_b), claims)
            stiff, (built_a, built_b) = self.built(bench, oil, claims)
        innovations = tuple(
            self._innovation(channel, built, claims)
            for channel, built in (("pressure_a", built_a), ("pressure_b", built_b))
        )
        force = eq.hydraulic_force(bench, built_a, built_b)
        arc = chambers.force_arc(bench, oil, stiff, self.a, self.step)
        return ChamberRun((innovations[0], innovations[1]), arc, force)

    def built(
        self, bench: Bench, oil: Oil, claims: Sequence[Claim]
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """beta/V [Pa/m3] of both chambers, and the pressure [Pa] that each sample builds in them."""
        into_a, into_b = chambers.net_flows(bench, oil, claims, self.memory)
        stiff = chambers.compliances(bench, oil, claims)
        return stiff, eq.pressure_rates(bench, stiff, (into_a * self.step, into_b * self.step), self._moved)

    @cached_property
    def _moved(self) -> FloatArray:
        """Change [m] of the position from each sample to the next."""
        position = self.channels["piston_position"]
        return np.diff(position, append=position[-1])

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
        return Oil(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool, oil.velocity)

    def _innovation(self, channel: str, built: FloatArray, claims: Sequence[Claim]) -> FloatArray:
        curved = [claim for claim in claims if claim.effect.curves == channel]
        if curved:  # an integral has lost its level, so a curve's slope is taken where the reading says that it is
            built = built * self._slope(channel, claims, curved)
            claims = [claim for claim in claims if claim.effect.curves != channel]
        gain = self.step / OBSERVER_MEMORY
        if not any(changes(claim, "measure") for claim in claims):
            return np.asarray(chambers.innovations(self.channels[channel], built, gain))
        integral = np.concatenate([[0.0], np.cumsum(built[:-1])])
        unexplained = self.channels[channel] - self.reading(channel, integral, claims)
        start = float(np.mean(unexplained[:10]))
        followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], unexplained, zi=[start])
        return unexplained - np.asarray(followed)

    def _slope(self, channel: str, claims: Sequence[Claim], curved: Sequence[Claim]) -> FloatArray:
        """Change of a curved reading [-] per change of its signal, within each sample."""
        signal = chambers.middle(self.true_signal(channel, claims))
        above, below = (self.reading(channel, signal + sign * SLOPE_STEP, curved) for sign in (1.0, -1.0))
        return np.asarray((above - below) / (2.0 * SLOPE_STEP))

    def pressure_doubt(self, noise: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """Standard deviations [Pa] of what both equations build, beyond the readings' own noise, decimated.

        Displacement and flow are only so well timed, and the flows are computed from pressures with `noise` [Pa].
        """
        bench = self.base
        timing = self._stiffest(0) * bench.piston_area * TIMING_DOUBT * self.smooth(np.abs(self.v))
        a, b = (
            self.kept(np.hypot(timing, self._flow_doubt(chamber, noise["pressure_" + chamber]))) for chamber in "ab"
        )
        return a, b

    def _stiffest(self, chamber: int) -> float:
        """beta/V [Pa/m3] of a chamber whose end the piston touches."""
        bench, moduli = self.base, (self.base.bulk_modulus, self.base.bulk_modulus)
        return float(eq.stiffnesses(bench, moduli, 0.0 if chamber == 0 else bench.stroke)[chamber])

    def _flow_doubt(self, chamber: str, noise: float) -> FloatArray:
        """Standard deviation [Pa] of a pressure that the noise of its own reading has built by way of the flow."""
        bench, current = self.base, self.channels["valve_current"]
        pressure = chambers.middle(self.channels["pressure_" + chamber])
        fed = current > 0.0 if chamber == "a" else current < 0.0
        drop = np.abs(np.where(fed, bench.supply_pressure - pressure, pressure - bench.tank_pressure))
        gain = bench.valve_gain * np.abs(current) / (2.0 * np.sqrt(np.maximum(drop, noise)))
        stiff = self._stiffest("ab".index(chamber))
        built = np.square(stiff * gain * noise * self.step)  # neighbours share a reading
        if self.spacing > 1:
            per_ampere = stiff * bench.valve_gain * np.sqrt(np.maximum(drop, noise)) * self.step
            built = built + np.square(per_ampere) * self._hidden_current()
        kept = (1.0 - self.step / OBSERVER_MEMORY) ** 2
        return np.sqrt(np.maximum(lfilter([1.0], [1.0, -kept], built), 0.0))

    def _hidden_current(self) -> FloatArray:
        """Variance [A^2] of what the box added to the current from sample to sample that no row shows, shape (n,).

        Of n samples per row n - 1 are not seen, and the one that is stands for all of them: together n (n - 1) times
        the variance of a single one. What half of the rows change does not tell: they do not see these either.
        """
        measured = self.segment.measured
        seen = np.ones(len(self.time), dtype=np.bool_) if measured is None else measured
        noise = white_noise(self.channels["valve_current"][self.segment.phase :: self.spacing])
        return np.where(seen, 0.0, self.spacing * noise**2)
