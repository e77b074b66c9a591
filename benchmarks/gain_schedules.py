# SPDX-License-Identifier: Apache-2.0
"""What two gains can reach: gains that vary with the phase of a known sine, found by the cross-entropy method.

Each schedule (K_p and K_i at 24 phases, linear between) repeats with the reference, and is found on the emulator's
default truth with knowledge that no controller has: the reference, the truth and its noise. So it bounds what a policy
of the paper's two gains can do there from below, as far as the search has come. 4 minutes a sine.
"""

from __future__ import annotations

import numpy as np

from benchmarks._report import parser
from benchmarks._truths import truth_fleet
from hydro_core.cli.console import Table, command, progress
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.envs import vector_runs
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import BASE_GAINS
from hydro_sim.emulator.truth.config import profile

RANGES = np.array((300.0, 50.0))
"""Largest K_p and K_i, of the wide authority; the least are 0."""
PHASES, POPULATION, ELITE = 24, 40, 8
START = np.array((105.0, 45.0)) / RANGES
"""The best fixed gains without a filter."""
TRIPPED = 1e3


def rmse(schedules: FloatArray, frequency: float, seed: int) -> FloatArray:
    """RMSE [N] of schedules in units of `RANGES`, shape (n, PHASES, 2); of one that trips `TRIPPED`."""
    steps = iter(range(10**6))

    def controller(samples: FloatArray) -> FloatArray:
        share, phase = np.modf(next(steps) * SAMPLES_PER_STEP * SAMPLE_PERIOD * frequency % 1.0 * PHASES)
        begin, end = schedules[:, int(phase) % PHASES], schedules[:, (int(phase) + 1) % PHASES]
        return ((1.0 - share) * begin + share * end) * RANGES - BASE_GAINS

    return np.nan_to_num(track(controller, len(schedules), frequency, seed), nan=TRIPPED)


def track(
    controller: vector_runs.VectorController,
    count: int,
    frequency: float,
    seed: int,
    compensator: Compensator | None = None,
) -> FloatArray:
    """RMSE [N] at 300 N, a second at least after the first two."""
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=frequency)
    settings = EvaluationSettings(settle=2.0, measure=1.0)
    cases = [Case("sine", signal)] * count
    return vector_runs.rmse(truth_fleet([profile("default")] * count), cases, controller, settings, seed, compensator)


def search(frequency: float, iterations: int, seed: int) -> FloatArray:
    """Return the best schedule found, shape (PHASES, 2)."""
    generator = np.random.default_rng(seed)
    mean = np.broadcast_to(START, (PHASES, 2)).copy()
    spread = np.full((PHASES, 2), 0.12)
    best = mean.copy()
    for _ in progress(range(iterations), total=iterations, label=f"{frequency:g} Hz", unit="iteration"):
        drawn = np.clip(mean + spread * generator.standard_normal((POPULATION, PHASES, 2)), 0.0, 1.0)
        drawn[0] = best
        elite = drawn[np.argsort(rmse(drawn, frequency, seed))[:ELITE]]
        best = elite[0]
        mean = 0.3 * mean + 0.7 * elite.mean(axis=0)
        spread = 0.3 * spread + 0.7 * (elite.std(axis=0) + 0.004)
    return best


@command()
def main() -> None:
    """Search and show."""
    options = parser("gain_schedules", __doc__)
    options.add_argument("--frequencies", type=float, nargs="+", default=[0.5, 1.0, 1.5, 2.0], metavar="HZ")
    options.add_argument("--iterations", type=int, default=120, metavar="N", help="of the search (%(default)s)")
    options.add_argument("--seed", type=int, default=0, metavar="N")
    asked = options.parse_args()
    columns = {"sine": "Hz, 300 N", "fixed": "(105, 45), RMSE, N", "scheduled": "best gains over the phase",
               "other": "those with other noise", "law": "compensated law"}  # fmt: skip
    table = Table(columns, title="Two gains at their best, emulator's default truth")
    for frequency in asked.frequencies:
        best = search(frequency, asked.iterations, asked.seed)
        both = np.stack((np.broadcast_to(START, best.shape), best))
        fixed, scheduled = rmse(both, frequency, asked.seed)
        law = track(vector_runs.fixed_gains(np.array(BASE_GAINS)), 1, frequency, asked.seed, Compensator(1))[0]
        other = rmse(best[np.newaxis], frequency, asked.seed + 1)[0]
        table.add(sine=frequency, fixed=fixed, scheduled=scheduled, other=other, law=law)
    table.show(asked.json)


if __name__ == "__main__":
    main()
