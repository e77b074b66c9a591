# SPDX-License-Identifier: Apache-2.0
"""A segment with its sensor models, and the slow observer of its chamber equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import Claim, FloatArray, Kinematics, Oil, Pair, changes, values_key
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.memory import RecordMemory
from hydro_diagnosis.preprocessing.smoothing import (
    STRIDE,
    finish,
    finish_at,
    kinematics,
    second_derivative,
    smooth,
    smooth_at,
    white_noise,
)
from hydro_diagnosis.recording import Segment
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING

BLOCK = 0.1
"""Averaging time [s] of the hydraulic balance."""
TAIL = 20
"""Recorded rows at a segment's end that are not judged, and `MARGIN` before and after one that is missing."""
MARGIN = 6
SETTLE = 0.3
"""Time [s] at the start of a segment that is not judged: filters and observer settle."""
Kept = TypeVar("Kept")
CACHE_SIZE = 10
"""Largest number of intermediate results that a segment keeps."""
LAG_ITERATIONS = 3
"""Iterations between the pressures behind lagging sensors and the flows that they drive."""
OBSERVER_MEMORY = 0.12
"""Memory [s] of the observer. A shorter one forgets the slow drift that a small leak builds up."""
SLOPE_STEP = 1e3
"""Step [Pa] of the differences that give the slope of a curved reading."""
TIMING_UNCERTAINTY = 3e-6
"""Timing uncertainty [s] between the equations, integrated sample by sample, and the sensors."""


class BoundedCache:
    """Results by key, up to a total size; the least recently used go first."""

    def __init__(self, room: float) -> None:
        self._room, self._size = room, 0.0
        self._found: dict[tuple[object, ...], tuple[Any, float]] = {}

    def get(self, key: tuple[object, ...]) -> Any:
        """Return the entry of a key, or None."""
        if key not in self._found:
            return None
        self._found[key] = self._found.pop(key)
        return self._found[key][0]

    def put(self, key: tuple[object, ...], what: Any, size: float = 1.0) -> None:
        """Store an entry of a size."""
        self._found[key] = what, size
        self._size += size
        while self._size > self._room and len(self._found) > 1:
            self._size -= self._found.pop(next(iter(self._found)))[1]

    def kept(self, key: tuple[object, ...], compute: Callable[[], Kept]) -> Kept:
        """Return the entry of a key, computed and stored if there is none."""
        if key not in self._found:
            self.put(key, compute())
        found: Kept = self.get(key)
        return found

    def clear(self) -> None:
        """Drop all entries."""
        self._found.clear()
        self._size = 0.0


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
        self.rows: npt.NDArray[np.int64] | slice = (
            like.rows if like else segment.judged(self.settle, end, STRIDE, MARGIN)
        )
        """Samples that are judged."""
        self._judged = np.arange(len(segment))[self.rows]
        if self.has_position:
            self.x, self.v, self.a = kinematics(channels["piston_position"], self.step, self.spacing)
            pressures = (channels["pressure_a"], channels["pressure_b"]) if self.has_pressures else None
            self.kinematics = Kinematics(self.time, self.x, self.v, pressures, self.a)
            bent = second_derivative(channels["piston_position"], self.step)
            self.recorded = Kinematics(self.time, channels["piston_position"], self.v, None, bent)
        self.beside = self._beside()
        """Signals that a sensor's reading may depend on besides its own, shape (n,) each."""
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

    @cached_property
    def unseen_ringing(self) -> float:
        """Frequency [Hz] at which the believed mass rings on the oil; 0 where the rows show it, twice in a period."""
        if self.spacing == 1 or not (self.has_position and self.has_pressures):
            return 0.0
        bench, moduli = self.base, (self.base.bulk_modulus, self.base.bulk_modulus)
        stiff_a, stiff_b = eq.stiffnesses(bench, moduli, float(np.mean(self.channels["piston_position"])))
        stiffness = bench.piston_area**2 * (stiff_a + bench.area_ratio**2 * stiff_b)
        ringing = float(np.sqrt(stiffness / bench.moving_mass) / (2.0 * np.pi))
        return ringing if 2.0 * ringing * self.step * self.spacing > 1.0 else 0.0

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

    def behind_cell(self, force: FloatArray, bench: Bench) -> FloatArray:
        """Load's force [N] behind the amplifier of its cell, if the bench states one."""
        if bench.load_cell_bandwidth is None:
            return force
        return self.memory.low_pass("load_force", force, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)

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


class ChamberObserver:
    """Both chambers of a segment under some claims, from recorded current, position and pressures."""

    def __init__(self, record: SegmentRecord) -> None:
        self._record = record
        self._cache = BoundedCache(CACHE_SIZE)

    def oil(self, claims: Sequence[Claim]) -> Oil:
        """Middle of each sample interval: the last interval repeats, so that lengths stay n."""
        moving = sorted((claim for claim in claims if changes(claim, "command")), key=lambda claim: claim.effect.stage)
        sensing = [claim for claim in claims if changes(claim, "unmeasure")]
        spool = self._cached("spool", moving, self._spool)
        p_a, p_b = self._cached("pressures", sensing, self._middle_pressures)
        position = self._cached(
            "position", (), lambda claims: chambers.middle(self._record.channels["piston_position"])
        )
        velocity = self._cached("velocity", (), lambda claims: chambers.middle(self._record.v))
        return Oil(self._record.time, position, (p_a, p_b), spool, velocity)

    def _spool(self, claims: Sequence[Claim]) -> FloatArray:
        """Each claim's spool is kept back, so that what comes later in the command's path begins there."""
        if not claims:
            return chambers.spool_position(
                self._record.channels["valve_current"], self._record.step / chambers.SUBSTEPS, ()
            )
        *before, last = claims
        spool = self._cached("spool", before, self._spool) if before else self._held_current
        return last.effect.command(spool, self._record.step / chambers.SUBSTEPS, last.values)

    @cached_property
    def _held_current(self) -> FloatArray:
        """A, shape (n, substeps)."""
        return np.repeat(self._record.channels["valve_current"][:, None], chambers.SUBSTEPS, axis=1)

    def _middle_pressures(self, claims: Sequence[Claim]) -> Pair:
        p_a, p_b = (chambers.middle(self._record.true_signal("pressure_" + chamber, claims)) for chamber in "ab")
        return p_a, p_b

    def _cached(self, what: str, claims: Sequence[Claim], compute: Callable[[Sequence[Claim]], Kept]) -> Kept:
        """Return the result for these claims, computed once as long as only others change."""
        return self._cache.kept((what, *values_key(claims)), lambda: compute(claims))

    def chamber_run(self, claims: Sequence[Claim]) -> ChamberRun:
        """Innovations and arcs under the claims."""
        bench = self._record.bench(claims)
        oil = self.oil(claims)
        stiff, (built_a, built_b) = self.built(bench, oil, claims)
        lagging = any(claim.effect.lagged.startswith("pressure") for claim in claims)
        for _ in range(LAG_ITERATIONS if lagging else 0):
            oil = self._ahead_of_lag(oil, (built_a, built_b), claims)
            stiff, (built_a, built_b) = self.built(bench, oil, claims)
        innovations = tuple(
            self._innovation(channel, built, claims)
            for channel, built in (("pressure_a", built_a), ("pressure_b", built_b))
        )
        force = eq.hydraulic_force(bench, built_a, built_b)
        arc = chambers.force_arc(bench, oil, stiff, self._record.a, self._record.step)
        return ChamberRun((innovations[0], innovations[1]), arc, force)

    def built(self, bench: Bench, oil: Oil, claims: Sequence[Claim]) -> tuple[Pair, Pair]:
        """beta/V [Pa/m3] of both chambers, and the pressure [Pa] that each sample builds in them."""
        into_a, into_b = chambers.net_flows(bench, oil, claims, self._record.memory)
        stiff = chambers.compliances(bench, oil, claims)
        return stiff, eq.pressure_rates(
            bench, stiff, (into_a * self._record.step, into_b * self._record.step), self._moved
        )

    @cached_property
    def _moved(self) -> FloatArray:
        """Change [m] of the position from each sample to the next."""
        position = self._record.channels["piston_position"]
        return np.diff(position, append=position[-1])

    def _ahead_of_lag(self, oil: Oil, built: Pair, claims: Sequence[Claim]) -> Oil:
        """The oil with pressures behind lagging sensors: what the lag swallows is taken from the pressure built."""
        others = [claim for claim in claims if not claim.effect.lagged.startswith("pressure")]
        pressures = list(oil.pressures)
        for index, channel in enumerate(("pressure_a", "pressure_b")):
            late = [claim for claim in claims if claim.effect.lagged == channel]
            if late:
                integral = np.concatenate([[0.0], np.cumsum(built[index][:-1])])
                swallowed = integral - self._record.reading(channel, integral, late)
                pressures[index] = chambers.middle(self._record.true_signal(channel, others) + swallowed)
        return Oil(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool, oil.velocity)

    def _innovation(self, channel: str, built: FloatArray, claims: Sequence[Claim]) -> FloatArray:
        curved = [claim for claim in claims if claim.effect.nonlinear_channel == channel]
        if curved:  # an integral has lost its level, so a curve's slope is taken where the reading says that it is
            built = built * self._slope(channel, claims, curved)
            claims = [claim for claim in claims if claim.effect.nonlinear_channel != channel]
        gain = self._record.step / OBSERVER_MEMORY
        if not any(changes(claim, "measure") for claim in claims):
            return np.asarray(chambers.innovations(self._record.channels[channel], built, gain))
        integral = np.concatenate([[0.0], np.cumsum(built[:-1])])
        unexplained = self._record.channels[channel] - self._record.reading(channel, integral, claims)
        start = float(np.mean(unexplained[:10]))
        followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], unexplained, zi=[start])
        return unexplained - np.asarray(followed)

    def _slope(self, channel: str, claims: Sequence[Claim], curved: Sequence[Claim]) -> FloatArray:
        """Change of a curved reading [-] per change of its signal, within each sample."""
        signal = chambers.middle(self._record.true_signal(channel, claims))
        above, below = (self._record.reading(channel, signal + sign * SLOPE_STEP, curved) for sign in (1.0, -1.0))
        return np.asarray((above - below) / (2.0 * SLOPE_STEP))

    def pressure_uncertainty(self, noise: Mapping[str, float]) -> Pair:
        """Standard deviations [Pa] of what both equations build, beyond the readings' own noise, decimated.

        Displacement and flow are only so well timed, and the flows are computed from pressures with `noise` [Pa].
        """
        bench = self._record.base
        timing = (
            self._stiffest(0) * bench.piston_area * TIMING_UNCERTAINTY * self._record.smooth(np.abs(self._record.v))
        )
        a, b = (
            self._record.kept(np.hypot(timing, self._flow_uncertainty(chamber, noise["pressure_" + chamber])))
            for chamber in "ab"
        )
        return a, b

    def _stiffest(self, chamber: int) -> float:
        """beta/V [Pa/m3] of a chamber whose end the piston touches."""
        bench, moduli = self._record.base, (self._record.base.bulk_modulus, self._record.base.bulk_modulus)
        return float(eq.stiffnesses(bench, moduli, 0.0 if chamber == 0 else bench.stroke)[chamber])

    def _flow_uncertainty(self, chamber: str, noise: float) -> FloatArray:
        """Standard deviation [Pa] of a pressure that the noise of its own reading has built by way of the flow."""
        bench, current = self._record.base, self._record.channels["valve_current"]
        pressure = chambers.middle(self._record.channels["pressure_" + chamber])
        fed = current > 0.0 if chamber == "a" else current < 0.0
        drop = np.abs(np.where(fed, bench.supply_pressure - pressure, pressure - bench.tank_pressure))
        gain = bench.valve_gain * np.abs(current) / (2.0 * np.sqrt(np.maximum(drop, noise)))
        stiff = self._stiffest("ab".index(chamber))
        built = np.square(stiff * gain * noise * self._record.step)  # neighbours share a reading
        if self._record.spacing > 1:
            per_ampere = stiff * bench.valve_gain * np.sqrt(np.maximum(drop, noise)) * self._record.step
            built = built + np.square(per_ampere) * self._hidden_current()
        kept = (1.0 - self._record.step / OBSERVER_MEMORY) ** 2
        return np.sqrt(np.maximum(lfilter([1.0], [1.0, -kept], built), 0.0))

    def _hidden_current(self) -> FloatArray:
        """Variance [A^2] of what the box added to the current from sample to sample that no row shows, shape (n,).

        Of n samples per row n - 1 are not seen, and the one that is stands for all of them: together n (n - 1) times
        the variance of a single one. What half of the rows change does not tell: they do not see these either.
        """
        measured = self._record.segment.measured
        seen = np.ones(len(self._record.time), dtype=np.bool_) if measured is None else measured
        noise = white_noise(self._record.channels["valve_current"][self._record.segment.phase :: self._record.spacing])
        return np.where(seen, 0.0, self._record.spacing * noise**2)
