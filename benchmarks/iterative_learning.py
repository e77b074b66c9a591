# SPDX-License-Identifier: Apache-2.0
"""How much of the compensated law's error repeats: iterative learning on top of it, over drawn truths.

    python -m benchmarks.iterative_learning --draw 24 --seed 7 --json learning.json

The law tracks each reference once with its estimator. Its coefficients of that run are then replayed, other noise each
time, and a_3 learns from repetition to repetition. What it reaches bounds what a policy can reach that sees a reference
for the first time: the rest is noise, or moves the valve more than the law does.

quiet   w <- w + 0.6 e, the error 12 ms ahead, smoothed with 8 ms
swift   w <- w + 0.6 (a_0 e + a_1 e' + a_2 e''), 6 ms ahead, smoothed with 8 ms

Interquartile means over the truths: RMSE [N], and RMSE and RMS of u' over the law's own.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks import _truth_fleet  # noqa: F401 - registers the truth plant
from benchmarks._drawn_truths import drawn_truths
from benchmarks._report import parser
from benchmarks.controllers import interquartile_mean
from hydro_bridge.cli.console import Table, progress
from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray, Law, ReferenceSignal, Waveform
from hydro_policy.compensation.estimator import ADAPTS, Compensator
from hydro_policy.envs.vector_env import VectorBench
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.truth.config import TruthConfig, truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench

REFERENCES = {
    "0.5 Hz": ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=0.5),
    "1 Hz": ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0),
    "2 Hz": ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=2.0),
    "multisine": ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=300.0, frequency=0.5),
    "steps": ReferenceSignal(waveform=Waveform.SMOOTH_STEP, amplitude=200.0, frequency=0.5),
}
STEPS, SETTLED = 600, 2000
"""Steps of a run, 6 s, and samples that do not count: the rest are whole periods of every reference."""
GAIN, SMOOTHING, LARGEST = 0.6, 8.0, 50.0
"""Share of the error that is learned, samples, and N of a_3."""
BEGIN = np.clip((np.arange(STEPS) - 60) / 40.0, 0.0, 1.0)
"""Of the learning, by step: the law arms first."""
REPETITIONS = (1, 2, 3, 5)
METHODS = {"quiet": 12, "swift": 6}
"""Samples by which the error is taken ahead."""


class Fleet:
    """Truths times references under the compensated law; arrays have a row for each pair, truths first."""

    def __init__(self, configs: Sequence[TruthConfig]) -> None:
        self.pairs = [(number, signal) for number in range(len(configs)) for signal in REFERENCES.values()]
        plants = [TruthPlant(configs[number]) for number, _ in self.pairs]
        self.bench = VectorBench([Bench.nominal()] * len(self.pairs), plants, BoxConfig())

    def run(self, seed: int, replayed: FloatArray | None = None) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return error [N] and current [A], shape (n, samples), and the coefficients, shape (n, steps, 4).

        `replayed`: the coefficients to follow; None: the estimator's.
        """
        for row, (number, signal) in enumerate(self.pairs):
            self.bench.begin(row, signal, 1000 * seed + number, law=Law.COMPENSATED)
        count = len(self.pairs)
        estimator, still = Compensator(count), np.zeros((count, 2))
        error, current = (np.zeros((count, STEPS, SAMPLES_PER_STEP)) for _ in range(2))
        followed = np.zeros((count, STEPS, 4)) if replayed is None else replayed
        for step in range(STEPS):
            if replayed is None:
                followed[:, step] = estimator.coefficients
            samples = self.bench.step(still, followed[:, step])
            active = np.all(samples["flags"] & ADAPTS == Flag.ARMED, axis=1)
            estimator.step(self.bench.compensated, samples["load_force"], active, samples["reference_force_rate"])
            error[:, step] = samples["reference_force"] - samples["load_force"]
            current[:, step] = samples["valve_current"]
        return error.reshape(count, -1), current.reshape(count, -1), followed


def scores(error: FloatArray, current: FloatArray) -> FloatArray:
    """RMSE [N] and RMS of u' [A/s], shape (2, truths, references)."""
    rmse = np.sqrt(np.mean(error[:, SETTLED:] ** 2, axis=1))
    rates = np.sqrt(np.mean((np.diff(current[:, SETTLED:]) / SAMPLE_PERIOD) ** 2, axis=1))
    return np.stack([rmse, rates]).reshape(2, -1, len(REFERENCES))


def lesson(method: str, error: FloatArray, coefficients: FloatArray) -> FloatArray:
    """What a_3 learns from a run, shape (n, steps)."""
    smooth = gaussian_filter1d(error, SMOOTHING, axis=1)
    if method == "swift":
        rate = np.gradient(smooth, SAMPLE_PERIOD, axis=1)
        a = np.repeat(coefficients, SAMPLES_PER_STEP, axis=1)
        smooth = a[..., 0] * smooth + a[..., 1] * rate + a[..., 2] * np.gradient(rate, SAMPLE_PERIOD, axis=1)
    middle = SAMPLES_PER_STEP * np.arange(STEPS) + SAMPLES_PER_STEP // 2 + METHODS[method]
    learned: FloatArray = GAIN * BEGIN * smooth[:, np.minimum(middle, smooth.shape[1] - 1)]
    return learned


def main(arguments: list[str] | None = None) -> int:
    """Run, print, write."""
    options = parser("iterative_learning", __doc__)
    options.add_argument("--draw", type=int, default=24, metavar="COUNT", help="truths, default %(default)s")
    options.add_argument("--seed", type=int, default=7, metavar="S", help="of the truths, default %(default)s")
    asked = options.parse_args(arguments)
    fleet = Fleet([truth_from_mapping(content) for content in drawn_truths(asked.draw, asked.seed).values()])
    law, limits = fleet.run(0), BoxLaw()
    own = scores(*law[:2])
    columns = {"method": "", "repetition": "", **dict.fromkeys(REFERENCES, "RMSE, N"), "ratio": "RMSE / law's",
               "u' ratio": "RMS of u' / law's", "largest": "ratio, of all pairs"}  # fmt: skip
    table = Table(columns, title=f"Iterative learning, {asked.draw} truths of seed {asked.seed}")

    def add(method: str, repetition: int, found: FloatArray) -> None:
        ratio = found / own
        means = {name: interquartile_mean(found[0, :, k]) for k, name in enumerate(REFERENCES)}
        table.add(method=method, repetition=repetition, **means, ratio=interquartile_mean(ratio[0].ravel()),
                  largest=float(ratio[0].max()), **{"u' ratio": interquartile_mean(ratio[1].ravel())})  # fmt: skip

    add("compensated law", 0, own)
    runs = [(method, repetition) for method in METHODS for repetition in range(REPETITIONS[-1] + 1)]
    for method, repetition in progress(runs, total=len(runs), label="repetitions", unit="run"):
        if repetition == 0:
            learned = np.zeros((len(fleet.pairs), STEPS))
        coefficients = law[2].copy()
        coefficients[..., 3] = np.clip(
            coefficients[..., 3] + learned, limits.coefficient_min[3], limits.coefficient_max[3]
        )
        error, current, _ = fleet.run(10 + repetition, coefficients)
        if repetition in REPETITIONS:
            add(method, repetition, scores(error, current))
        learned = np.clip(learned + lesson(method, error, law[2]), -LARGEST, LARGEST)
    table.show(asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
