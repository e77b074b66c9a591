# SPDX-License-Identifier: Apache-2.0
"""Residuals of a set of claims: the part of the recordings that the bench with these effects does not explain.

::

    pressure_a, pressure_b   innovations of a slow observer of the chamber equations, 120 ms of memory     1 kHz / 5
    motion                   f_h - (m x'' + b x' + dry friction + spring), weak form                        1 kHz / 5
    load                     f_l - reading of its sensor for the load's force                                1 kHz / 5
    hydraulic                f_h - (A_p p_a - alpha A_p p_b), means over 100 ms: the slow part, which the
                             observer forgets; the fast part is in the other residuals already
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numpy.polynomial.hermite_e import hermegauss
from scipy.ndimage import correlate1d
from scipy.signal import lfilter

from hydro_core.bench_scales import unit_ratio
from hydro_diagnosis.bench_parameters import load_cell_at_rod
from hydro_diagnosis.effects.base import (
    HYDRAULIC,
    LOAD,
    MOTION,
    SLOPE_STEP,
    BoundedCache,
    ChamberInputs,
    EffectHypothesis,
    FloatArray,
    Kinematics,
    Pair,
    claims_acting_in,
)
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import AVERAGING_TIME, OBSERVER_TIME_CONSTANT, ChamberRun, observer_gain
from hydro_diagnosis.preprocessing.smoothing import (
    KINEMATIC_WIDTH,
    STRIDE,
    TOTAL_WIDTH,
    kinematics,
    second_derivative,
    smooth,
    smooth_at,
    smooth_kinematic,
    smooth_kinematic_at,
)
from hydro_diagnosis.recording import Segment
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.base import DECLARED_SIZE
from hydro_sim.model.equations import LOAD_CELL_DAMPING

LAG_ITERATIONS = 3
"""Iterations between the pressures behind lagging sensors and the flows that they drive."""
_NODES, _WEIGHTS = hermegauss(3)
"""Gauss-Hermite nodes and weights of a mean over a Gaussian; the weights sum to the root of two pi."""


class SegmentModel:
    """Model of a segment: residuals [SI units] of the assumed bench with effects, from recorded channels and motion.

    `like`: model of the same segment with all recorded rows, whose evaluated samples are used here too.
    """

    def __init__(self, segment: Segment, bench: Bench, like: SegmentModel | None = None) -> None:
        self.segment = segment
        self.base = bench
        """Assumed bench, without the corrections of any claim."""
        self.step = segment.step
        self.spacing = segment.spacing
        self.time = segment.time
        channels = segment.channels
        self.channels = channels
        self.has_position = "piston_position" in channels
        self.has_pressures = {"pressure_a", "pressure_b"} <= channels.keys()
        self.load_cell_at_rod = load_cell_at_rod(channels, bench)
        """Whether the load's force in the motion equation is the reading of the load cell."""
        self.settle = min(round(2.5 * OBSERVER_TIME_CONSTANT / self.step), len(segment) // 4)
        """Number of samples at the start that are not evaluated, while filters and observer settle to 8 %."""
        end = len(segment) - 20 * self.spacing  # the last rows are not evaluated
        margin = round(4.0 * TOTAL_WIDTH)  # reach of the test function to either side, free of missing rows
        self.rows: npt.NDArray[np.int64] | slice = (
            like.rows if like else segment.evaluated_rows(self.settle, end, STRIDE, margin)
        )
        """Evaluated samples, at which residuals are taken."""
        self._evaluated = np.arange(len(segment))[self.rows]
        if self.has_position:
            self.x, self.v, self.a = kinematics(channels["piston_position"], self.step, self.spacing)
            pressures = (channels["pressure_a"], channels["pressure_b"]) if self.has_pressures else None
            self.kinematics = Kinematics(self.time, self.x, self.v, pressures, self.a)
            bent = second_derivative(channels["piston_position"], self.step)
            self.recorded = Kinematics(self.time, channels["piston_position"], self.v, None, bent)
        self.other_signals = {name: channels[name] for name in ("pressure_a", "pressure_b") if name in channels}
        """Signals that a sensor's reading may depend on besides its own, shape (n,) each."""
        if self.has_position:
            self.other_signals |= {"position": channels["piston_position"], "velocity": self.v, "acceleration": self.a}
        if "valve_current" in channels:  # a reading is taken under the current that was held until then
            current = channels["valve_current"]
            self.other_signals["current"] = np.concatenate([current[:1], current[:-1]])
        self.memory = Memory(segment.step, self.other_signals)
        self._cache = BoundedCache(10)  # intermediate results
        self._corrected_models = BoundedCache(4)  # models with corrected positions

    def bench(self, claims: Sequence[EffectHypothesis]) -> Bench:
        """Return the bench with the parameters that the claims correct."""
        bench = self.base
        for claim in claims_acting_in(claims, "correct"):
            bench = claim.effect.correct(bench, claim.values)
        return bench

    @cached_property
    def aliased_resonance(self) -> float:
        """Hydraulic natural frequency [Hz] of the assumed bench if above the rows' Nyquist frequency, else 0."""
        if self.spacing == 1 or not (self.has_position and self.has_pressures):
            return 0.0
        bench, moduli = self.base, (self.base.bulk_modulus, self.base.bulk_modulus)
        stiff_a, stiff_b = eq.stiffnesses(bench, moduli, float(np.mean(self.channels["piston_position"])))
        stiffness = bench.piston_area**2 * (stiff_a + bench.area_ratio**2 * stiff_b)
        ringing = float(np.sqrt(stiffness / bench.moving_mass) / (2.0 * np.pi))
        return ringing if 2.0 * ringing * self.step * self.spacing > 1.0 else 0.0

    def true_signal(self, channel: str, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Return the true signal of a channel, shape (n,): its recording with the claimed sensor errors inverted."""
        signal = self.channels[channel]
        for claim in claims_acting_in(claims, "invert_reading"):
            signal = claim.effect.invert_reading(channel, signal, self.memory, claim.values)
        return signal

    def reading(
        self, channel: str, signal: FloatArray, claims: Sequence[EffectHypothesis], smoothed: bool = False
    ) -> FloatArray:
        """Return the reading of a channel's sensor for a true signal; `smoothed`: through the test function."""
        self.memory.other_signals = self._smoothed_signals if smoothed else self.other_signals
        for claim in claims_acting_in(claims, "read_sensor"):
            signal = claim.effect.read_sensor(channel, signal, self.memory, claim.values)
        self.memory.other_signals = self.other_signals
        return signal

    def behind_cell(self, force: FloatArray, bench: Bench) -> FloatArray:
        """Return the load force [N], shape (n,), as the load cell measures it: low-pass filtered by the amplifier.

        Unfiltered if the bench gives no bandwidth.
        """
        if bench.load_cell_bandwidth is None:
            return force
        return self.memory.low_pass(force, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)

    @cached_property
    def _smoothed_signals(self) -> dict[str, FloatArray]:
        smoothed = {name: self.smooth(signal) for name, signal in self.other_signals.items() if name != "acceleration"}
        return smoothed | ({"acceleration": self.smooth_kinematic(self.a)} if self.has_position else {})

    def at_evaluated(self, signal: FloatArray) -> FloatArray:
        """Return a signal at the evaluated samples, shape (rows,): every fifth recorded row once settled."""
        return signal[self.rows]

    def smooth(self, signal: FloatArray) -> FloatArray:
        """Return a measured signal smoothed by the test function, shape (n,)."""
        return smooth(signal, self.spacing)

    def smooth_kinematic(self, signal: FloatArray) -> FloatArray:
        """Return a signal of the smoothed motion, smoothed further to the test function's width, shape (n,)."""
        return smooth_kinematic(signal, self.spacing)

    def smooth_at_evaluated(self, signal: FloatArray) -> FloatArray:
        """Return `smooth` at the evaluated samples only, shape (rows,)."""
        return smooth_at(signal, self._evaluated, self.spacing)

    def smooth_kinematic_at_evaluated(self, signal: FloatArray) -> FloatArray:
        """Return `smooth_kinematic` at the evaluated samples only, shape (rows,)."""
        return smooth_kinematic_at(signal, self._evaluated, self.spacing)

    def means(self, signal: FloatArray) -> FloatArray:
        """Return the means of a signal over blocks of `AVERAGING_TIME`, once settled, shape (blocks,)."""
        length, settled = round(AVERAGING_TIME / self.step), signal[self.settle :]
        return settled[: len(settled) // length * length].reshape(-1, length).mean(axis=1)

    def evaluated_time(self) -> FloatArray:
        """Return the times [s] of the decimated residuals, shape (rows,)."""
        return self.at_evaluated(self.time)

    def block_time(self) -> FloatArray:
        """Return the times [s] of the block means, shape (blocks,)."""
        length = round(AVERAGING_TIME / self.step)
        count = (len(self.time) - self.settle) // length
        return self.time[self.settle] + (np.arange(count) + 0.5) * length * self.step

    # -- chambers, from recorded current, position and pressures -------------------------------------------------------

    def oil(self, claims: Sequence[EffectHypothesis]) -> ChamberInputs:
        """Return position, velocity, chamber pressures and spool at the middle of each sample interval, shape (n,).

        The last value is repeated. The spool has shape (n, substeps).
        """
        moving = sorted(claims_acting_in(claims, "command"), key=lambda claim: claim.effect.stage)
        spool = self._cache.get_or_compute("spool", moving, self._spool)
        p_a, p_b = self._cache.get_or_compute(
            "pressures", claims_acting_in(claims, "invert_reading"), self._interval_pressures
        )
        position = self._cache.get_or_compute(
            "position", (), lambda claims: chambers.interval_means(self.channels["piston_position"])
        )
        velocity = self._cache.get_or_compute("velocity", (), lambda claims: chambers.interval_means(self.v))
        return ChamberInputs(self.time, position, (p_a, p_b), spool, velocity)

    def _spool(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Spool position [A], shape (n, substeps); without claims it is constant in a sample: one substep.

        The spool after each claim is cached, as the input of claims that follow in the command path.
        """
        if len(claims) > 1:
            spool = self._cache.get_or_compute("spool", claims[:-1], self._spool)
        else:
            spool = np.repeat(self.channels["valve_current"][:, None], chambers.SUBSTEPS if claims else 1, axis=1)
        for claim in claims[-1:]:
            spool = claim.effect.command(spool, Memory(self.step / chambers.SUBSTEPS), claim.values)
        return spool

    def _interval_pressures(self, claims: Sequence[EffectHypothesis]) -> Pair:
        p_a, p_b = (chambers.interval_means(self.true_signal("pressure_" + chamber, claims)) for chamber in "ab")
        return p_a, p_b

    def chamber_run(self, claims: Sequence[EffectHypothesis]) -> ChamberRun:
        """Return the chambers' innovations and the increments and interpolation errors of f_h under the claims."""
        bench = self.bench(claims)
        oil = self.oil(claims)
        stiff, (increments_a, increments_b) = self.pressure_increments(bench, oil, claims)
        lagging = any(claim.effect.lagged_channel.startswith("pressure") for claim in claims)
        for _ in range(LAG_ITERATIONS if lagging else 0):
            oil = self._ahead_of_lag(oil, (increments_a, increments_b), claims)
            stiff, (increments_a, increments_b) = self.pressure_increments(bench, oil, claims)
        innovations = tuple(
            self._innovation(channel, increments, claims)
            for channel, increments in (("pressure_a", increments_a), ("pressure_b", increments_b))
        )
        force = eq.hydraulic_force(bench, increments_a, increments_b)
        error = chambers.force_interpolation_error(bench, oil, stiff, self.a, self.step)
        return ChamberRun((innovations[0], innovations[1]), error, force)

    def pressure_increments(
        self, bench: Bench, oil: ChamberInputs, claims: Sequence[EffectHypothesis]
    ) -> tuple[Pair, Pair]:
        """Return beta/V [Pa/m3] of both chambers, and the pressure increments [Pa] per sample in them."""
        into_a, into_b = chambers.net_flows(bench, oil, claims, self.memory)
        stiff, position = chambers.chamber_stiffnesses(bench, oil, claims), self.channels["piston_position"]
        moved = np.diff(position, append=position[-1])
        return stiff, eq.pressure_rates(bench, stiff, (into_a * self.step, into_b * self.step), moved)

    def _ahead_of_lag(self, oil: ChamberInputs, increments: Pair, claims: Sequence[EffectHypothesis]) -> ChamberInputs:
        """The oil with the true pressures of lagging sensors: the lag's error is that for the pressure increments."""
        others = [claim for claim in claims if not claim.effect.lagged_channel.startswith("pressure")]
        pressures = list(oil.pressures)
        for index, channel in enumerate(("pressure_a", "pressure_b")):
            late = [claim for claim in claims if claim.effect.lagged_channel == channel]
            if late:
                integral = np.concatenate([[0.0], np.cumsum(increments[index][:-1])])
                swallowed = integral - self.reading(channel, integral, late)
                pressures[index] = chambers.interval_means(self.true_signal(channel, others) + swallowed)
        return ChamberInputs(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool, oil.velocity)

    def _innovation(self, channel: str, increments: FloatArray, claims: Sequence[EffectHypothesis]) -> FloatArray:
        curved = [claim for claim in claims if claim.effect.nonlinear_channel == channel]
        if curved:  # the integral has no absolute level: the sensor's slope is taken at the recorded level
            increments = increments * self.reading_slope(channel, self.true_signal(channel, claims), curved)
            claims = [claim for claim in claims if claim.effect.nonlinear_channel != channel]
        gain = observer_gain(self.step)
        if not claims_acting_in(claims, "read_sensor"):
            return np.asarray(chambers.innovations(self.channels[channel], increments, gain))
        integral = np.concatenate([[0.0], np.cumsum(increments[:-1])])
        unexplained = self.channels[channel] - self.reading(channel, integral, claims)
        start = float(np.mean(unexplained[:10]))
        followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], unexplained, zi=[start])
        return unexplained - np.asarray(followed)

    def reading_slope(self, channel: str, signal: FloatArray, curved: Sequence[EffectHypothesis]) -> FloatArray:
        """Slope [-] of a nonlinear sensor's reading over its true signal, in the middle of each interval, (n,)."""
        signal = chambers.interval_means(signal)
        step = SLOPE_STEP * self.base.size.pressure
        above, below = (self.reading(channel, signal + sign * step, curved) for sign in (1.0, -1.0))
        return np.asarray((above - below) / (2.0 * step))

    # -- forces --------------------------------------------------------------------------------------------------------

    def dry_friction_magnitude(
        self, claims: Sequence[EffectHypothesis], velocity: FloatArray | None = None
    ) -> FloatArray:
        """Magnitude [N] of sliding dry friction at the smoothed, or a given, velocity [m/s], shape (n,)."""
        motion = self.kinematics if velocity is None else Kinematics(self.time, self.x, velocity)
        level = np.zeros_like(self.x)
        for claim in claims_acting_in(claims, "dry_level"):
            level = claim.effect.dry_level(level, motion, claim.values)
        return level

    def load_force(self, bench: Bench, claims: Sequence[EffectHypothesis], motion: Kinematics) -> FloatArray:
        """Force [N] of the load under claims, without sensor errors, shape (n,)."""
        force = bench.spring_stiffness * (motion.position - bench.spring_rest_position)
        for claim in claims_acting_in(claims, "load"):
            force = claim.effect.load(force, motion, bench, self.memory, claim.values)
        return force

    def dry_friction(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Signed dry friction [N], averaged over the velocities within the first Gaussian; 0 with bristles, (n,).

        Friction is nonlinear in the velocity. At the smoothed velocity alone, a Stribeck rise that the piston passes
        within milliseconds would be a quarter too small.
        """
        force = np.zeros_like(self.x)
        if not claims_acting_in(claims, "dry_level") or any(claim.effect.models_presliding for claim in claims):
            return force
        for weight, velocity, sign in self._seen_velocities:
            force += weight * self.dry_friction_magnitude(claims, velocity) * sign
        return force

    @cached_property
    def _seen_velocities(self) -> tuple[tuple[float, FloatArray, FloatArray], ...]:
        """Weight, velocity [m/s] and its smoothed sign at each node of the first Gaussian."""
        width = KINEMATIC_WIDTH * self.spacing * self.step
        nodes = (
            (weight, self.v + node * width * self.a)
            for node, weight in zip(_NODES, _WEIGHTS / _WEIGHTS.sum(), strict=True)
        )
        slip = 3e-4 * unit_ratio(
            "m/s", DECLARED_SIZE, self.base.size
        )  # m/s over which dry friction changes sign: twice
        # the noise of a velocity from a 1 um encoder on a stroke of 80 mm
        return tuple((weight, velocity, np.tanh(velocity / slip)) for weight, velocity in nodes)

    def required_force(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Hydraulic force [N] required by the recorded motion (inverse dynamics), after the first Gaussian, (n,)."""
        bench = self.bench(claims)
        force = self.dry_friction(claims)
        resisting = claims_acting_in(claims, "opposing_force")
        level = self.dry_friction_magnitude(claims) if resisting else force
        for claim in resisting:
            force = claim.effect.opposing_force(force, level, self.kinematics, self.memory, claim.values)
        inertia = bench.moving_mass * self.a + bench.viscous_friction * self.v
        return inertia + force + self.load_force(bench, claims, self.kinematics)

    def variable(self, name: str) -> FloatArray:
        """Return a variable on which a hidden input may depend, by name, shape (n,), SI units."""
        if name == "pressure_difference":
            return self.smooth(self.channels["pressure_a"] - self.channels["pressure_b"])
        if name == "current":
            return self.channels["valve_current"]
        attribute = {"time": "time", "position": "x", "velocity": "v"}.get(name)
        signal: FloatArray = getattr(self, attribute) if attribute else self.smooth(self.channels[name])
        return signal

    def with_true_position(self, claims: Sequence[EffectHypothesis]) -> SegmentModel:
        """Return the segment with the piston's position under these claims; itself if no claim is a position error."""
        moving = [claim for claim in claims if claim.effect.is_position_error]
        if not moving or not self.has_position:
            return self

        def build_corrected(moving: Sequence[EffectHypothesis]) -> SegmentModel:
            channels = {**self.channels, "piston_position": self.true_signal("piston_position", moving)}
            return SegmentModel(replace(self.segment, channels=channels), self.base, self)

        return self._corrected_models.get_or_compute("position", moving, build_corrected)

    def residuals(self, block: str, claims: Sequence[EffectHypothesis]) -> dict[str, FloatArray]:
        """Return the residuals of a block under its claims by channel, decimated: Pa or N.

        That of the pressures also has `interpolation_error` [N]: the excess of the mean of f_h around each sample over
        f_h, by linear interpolation between samples (second differences over 12) plus `ChamberRun.interpolation_error`.
        """
        model = self.with_true_position(claims)
        if block == MOTION:
            return {"motion": model.motion_residual(claims)}
        if block == LOAD:
            bench = model.bench(claims)
            force = model.behind_cell(model.load_force(bench, claims, model.recorded), bench)
            off = model.channels["load_force"] - model.reading("load_force", force, claims)
            return {"load": model.smooth_at_evaluated(off)}
        if block == HYDRAULIC:
            return {"hydraulic": model.hydraulic_residual(claims)}
        run = model.chamber_run(claims)
        a, b = (model.smooth_at_evaluated(innovation) for innovation in run.innovations)
        return {
            "pressure_a": a,
            "pressure_b": b,
            "interpolation_error": model.smooth_at_evaluated(run.interpolation_error)
            + model._linear_interpolation_error,
        }

    def motion_residual(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Return the residual [N] of the motion equation, decimated, without the interpolation error."""
        required = self.required_force(claims)
        if "hydraulic_force" not in self.channels or not claims_acting_in(claims, "read_sensor"):
            return self.measured_force(claims) - self.smooth_kinematic_at_evaluated(required)
        shown = self.reading("hydraulic_force", self.smooth_kinematic(required), claims, smoothed=True)
        return self.measured_force(claims) - self.at_evaluated(shown)

    def measured_force(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Hydraulic force [N] of the force cell, or else of the pressures, less a load cell's at the rod, decimated."""
        if "hydraulic_force" in self.channels:
            return self._cell_force
        bench = self.bench(claims)
        p_a, p_b = (self.true_signal("pressure_" + chamber, claims) for chamber in "ab")
        return self.smooth_at_evaluated(bench.piston_area * (p_a - bench.area_ratio * p_b) - self._given_away)

    @cached_property
    def _cell_force(self) -> FloatArray:
        return self.smooth_at_evaluated(self.channels["hydraulic_force"] - self._given_away)

    @property
    def _given_away(self) -> FloatArray | float:
        return self.channels["load_force"] if self.load_cell_at_rod else 0.0

    @property
    def driving_force(self) -> FloatArray:
        """Recorded force [N] on the piston, of the force cell, or else of the pressures, less the load cell's, (n,)."""
        force = self.channels.get("hydraulic_force")
        if force is None:
            p_a, p_b = self.channels["pressure_a"], self.channels["pressure_b"]
            force = self.base.piston_area * (p_a - self.base.area_ratio * p_b)
        return force - self._given_away

    @cached_property
    def _linear_interpolation_error(self) -> FloatArray:
        """Excess [N] of the mean of linearly interpolated f_h around each sample over the sample, decimated."""
        bent = correlate1d(self.driving_force, (1.0 / 12.0, -2.0 / 12.0, 1.0 / 12.0), mode="nearest")
        return self.smooth_at_evaluated(bent)

    def hydraulic_residual(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Hydraulic residual [N], block means. A pressure sensor's lag is not inverted: all else is delayed alike."""
        bench = self.bench(claims)
        late = [one for one in claims if one.effect.lagged_channel.startswith("pressure")]
        others = [claim for claim in claims if claim not in late]

        def delayed(signal: FloatArray, but: str) -> FloatArray:
            for claim in late:
                if claim.effect.lagged_channel != but:
                    signal = claim.effect.read_sensor(claim.effect.lagged_channel, signal, self.memory, claim.values)
            return signal

        channels = ("pressure_a", "pressure_b")
        p_a, p_b = (delayed(self.true_signal(channel, others), channel) for channel in channels)
        force = bench.piston_area * (p_a - bench.area_ratio * p_b)
        off = delayed(self.channels["hydraulic_force"], "") - self.reading("hydraulic_force", force, others)
        return self.means(off)
