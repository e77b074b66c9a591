# SPDX-License-Identifier: Apache-2.0
"""One call of the contraction filter, exact Jacobians against finite differences, over 1e5 samples of tracked forces.

The samples come from the analytic bench under changing gains; every other one is given a destabilizing gain, so that
the QP has work in almost half of the calls. Both filters see the same samples in turn, in one process.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from benchmarks._report import percentiles
from hydro_bridge.console import Table, add_json_argument
from hydro_bridge.signals import FloatArray, ReferenceSignal, Waveform
from hydro_filter import dynamics
from hydro_filter.controller import ForceLaw
from hydro_filter.dynamics import AnalyticDynamics, Linearization
from hydro_filter.filter import ContractionFilter
from hydro_filter.sample import Sample
from hydro_filter.state import LOAD_FORCE, STATES, state_scale
from hydro_sim import force_law
from hydro_sim.bench import Bench
from hydro_sim.offline import Schedule, simulate
from hydro_sim.plant import AnalyticPlant

STEP = 1e-5
"""Of the differences, relative to each state's scale."""


class DifferencedDynamics(AnalyticDynamics):
    """A and B from central differences of the same compiled f: 19 evaluations."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.steps = STEP * state_scale(bench)

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """See `Dynamics.linearize`."""
        linear = Linearization(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        for i in range(STATES):
            linear.state_matrix[:, i] = self._slope(state, current, i, self.steps[i], 0.0)
        linear.input_vector[:] = self._slope(state, current, 0, 0.0, STEP)
        dynamics.state_rate(self.constants, state, current, linear.state_rate)
        return linear

    def _slope(self, state: FloatArray, current: float, i: int, step: float, current_step: float) -> FloatArray:
        sides = np.empty((2, STATES))
        for side, sign in enumerate((1.0, -1.0)):
            probe = state.copy()
            probe[i] += sign * step
            dynamics.state_rate(self.constants, probe, current + sign * current_step, sides[side])
        return (sides[0] - sides[1]) / (2.0 * (step + current_step))


class DifferencedLaw(ForceLaw):
    """K from central differences of the compiled force law: 16 evaluations."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self.steps = STEP * state_scale(bench)

    def gradient(self, sample: Sample) -> FloatArray:
        """See `Controller.gradient`."""
        out = np.empty(STATES)
        # the part of the law that no state moves, from the current that it gave
        still = self._current(sample, sample.state, 0.0)
        slope = self._current(sample, sample.state, 1.0) - still
        wanted = (sample.nominal_current - still) / slope
        for i in range(STATES):
            probe = sample.state.copy()
            probe[i] += self.steps[i]
            above = self._current(sample, probe, wanted)
            probe[i] -= 2.0 * self.steps[i]
            out[i] = (above - self._current(sample, probe, wanted)) / (2.0 * self.steps[i])
        return out

    def _current(self, sample: Sample, state: FloatArray, reference_rate: float) -> float:
        error = sample.reference_force - state[LOAD_FORCE]
        known = (error, 0.0, reference_rate, sample.proportional_gain, 0.0, self.gain_floor)
        return float(force_law.nominal_current(self.constants[0], state, *known))


def differenced(bench: Bench) -> ContractionFilter:
    """The same filter on finite differences."""
    exact = ContractionFilter.for_bench(bench)
    parts = {name: getattr(exact.certificate, name) for name in type(exact.certificate).__dataclass_fields__}
    parts |= {"dynamics": DifferencedDynamics(bench), "controller": DifferencedLaw(bench)}
    return ContractionFilter(type(exact.certificate)(**parts), exact.settings)


def tracked(bench: Bench, count: int) -> list[Sample]:
    """`count` samples of a 200 N sine under gains that change every half second."""
    rng = np.random.default_rng(0)
    draws = -(-count // 500)
    gains = np.repeat(np.column_stack([rng.uniform(15, 90, draws), rng.uniform(5, 15, draws)]), 50, axis=0)
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
    records = simulate(AnalyticPlant(bench), bench, Schedule(reference=signal, gains=gains, seconds=1e-3 * count))
    samples = [Sample.of(record) for record in records]
    return [
        sample._replace(proportional_gain=float(rng.uniform(-40, 0))) if k % 2 else sample
        for k, sample in enumerate(samples)
    ]


def measure(filters: dict[str, ContractionFilter], samples: list[Sample]) -> tuple[dict[str, list[float]], float]:
    """Durations [s] of every call by filter, and the relative difference of M_c that 99 % of the samples keep.

    Differences that straddle the valve's kink at zero current are off by more.
    """
    durations: dict[str, list[float]] = {name: [] for name in filters}
    apart: list[float] = []
    for sample in samples:
        values = []
        for name, contraction_filter in filters.items():
            begin = time.perf_counter()
            result = contraction_filter.correct(sample)
            durations[name].append(time.perf_counter() - begin)
            values.append(result.before)
        apart.append(float(np.ptp(values)) / max(1e-3, abs(values[0])))
    return durations, float(np.percentile(apart, 99))


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.filter_call", description=__doc__)
    parser.add_argument("--samples", type=int, default=100_000, help="default 100000")
    add_json_argument(parser)
    asked = parser.parse_args(arguments)
    bench = Bench.nominal()
    filters = {"exact": ContractionFilter.for_bench(bench), "differences": differenced(bench)}
    samples = tracked(bench, asked.samples)
    measure(filters, samples[:200])  # compiles
    durations, apart = measure(filters, samples)
    worked = filters["exact"].qp.counts.solved / (len(samples) + 200)
    table = Table(
        {"jacobians": "of the certificate", "p50": "us per call", "p99": "", "p99.9": "", "max": "", "ratio": "of p50"},
        title=f"Filter call, {len(samples)} samples, the QP at work in {worked:.0%}; M_c agrees to {apart:.0e} in 99 %",
    )
    shown = {name: percentiles(values) for name, values in durations.items()}
    for name, values in shown.items():
        table.add(jacobians=name, **values, ratio=values["p50"] / shown["exact"]["p50"])
    table.show(asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
