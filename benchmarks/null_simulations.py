# SPDX-License-Identifier: Apache-2.0
"""Null simulations: recordings with nothing missing, searched without a threshold, to measure evidence by chance.

    python -m benchmarks.null_simulations --runs 200 --write null_simulations.jsonl
    python -m benchmarks.null_simulations --coverage --runs 40      95 % intervals under noise as real sensors have it

The assumed bench is recorded and searched for the one claim that explains it best: its evidence is what the choice
among all hypotheses makes of noise. With a threshold above that evidence, nothing is claimed. With --write, finished
trials are saved, and the same command resumes from them; those of another version are run again.
"""

from __future__ import annotations

from math import exp
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from benchmarks._report import parser, results
from benchmarks.prove.blind import ENGINE
from hydro_core.cli.console import Table, bounded_number, command
from hydro_core.signals import FloatArray, ReferenceSignal, Waveform
from hydro_diagnosis.bench_parameters import parse_bench
from hydro_diagnosis.effects import CANDIDATES, LIBRARY, EffectHypothesis
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import simulated_recording
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.search import Search, SearchSettings
from hydro_sim.model.bench import Bench


def trial(bench: Bench, seed: int) -> tuple[float, float | None, str]:
    """Record the bench as believed under two drawn references, gains and one noise, and search.

    Returns the scale of the sensors' noise; the evidence of the best claim [BIC], below 0 where it does not pay its
    price, None if no claim is large enough; the claim.
    """
    rng = np.random.default_rng(seed)
    noise = float(np.exp(rng.uniform(np.log(0.1), np.log(4.0))))
    segments: list[Segment] = []
    for k, waveform in enumerate(rng.permutation([Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP])[:2]):
        reference = ReferenceSignal(
            waveform=Waveform(int(waveform)),
            amplitude=float(rng.uniform(150.0, 300.0)),
            offset=float(rng.uniform(-40.0, 40.0)),
            frequency=float(rng.uniform(0.4, 1.0)),
        )
        gains = float(rng.uniform(30.0, 90.0)), float(rng.uniform(5.0, 15.0))
        recording = simulated_recording(bench, reference, gains=gains, seconds=20.0, noise=noise, seed=seed * 10 + k)
        segments += recording.segments
    settings = SearchSettings(threshold=-1e3, max_claims=1)
    with threadpool_limits(1, "blas"):
        search = Search(Problem(segments, bench), [one.adapted(bench) for one in CANDIDATES], settings)
        search.run()
    return (noise, -search.steps[0].score, search.steps[0].label) if search.steps else (noise, None, "none")


FRICTION = {"friction_coulomb": {"force": 10.0}, "friction_viscous": {"coefficient": 40.0},
            "force_offset": {"force": 5.0}}  # fmt: skip
"""Truth of the intervals."""
STEP, STROKE = 1e-3, 3.0
"""s: of a recording's rows, and of each of its strokes at constant speed."""


def disturbed(kind: str, force: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Reading [N] of a force cell with 0.3 N of white noise and one thing more."""
    white, time = 0.3 * rng.standard_normal(len(force)), STEP * np.arange(len(force))
    wander = np.sqrt(STEP) * np.cumsum(rng.standard_normal(len(force)))
    match kind:
        case "coloured, 0.3 s" | "coloured, 2 s":
            keep = exp(-STEP / (0.3 if "0.3" in kind else 2.0))
            drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(len(force) + 10000)
            white += lfilter([1.0], [1.0, -keep], drive)[10000:]
        case "drift, 0.3 N over 1 s":
            white += 0.3 * wander
        case "vibration, 2 N at 12 Hz":
            white += 2.0 * np.sin(2.0 * np.pi * 12.0 * time + 3.0 * wander)
        case "steps of 1 N":
            return np.asarray(np.round(force + white))
    return force + white


def covered(kind: str, strokes: bool, seed: int) -> list[tuple[bool, float]]:
    """Whether the interval of each number of `FRICTION` holds it, and half its width over the number.

    40 s of `strokes` at constant speeds, else of two sines.
    """
    rng = np.random.default_rng([seed, len(kind)])
    time = STEP * np.arange(40000, dtype=np.float64)
    if strokes:
        speeds = np.repeat(rng.uniform(0.01, 0.06, 7), 2) * np.tile([1.0, -1.0], 7)
        velocity = uniform_filter1d(np.repeat(speeds, round(STROKE / STEP))[: len(time)], 200)
        position = 0.02 + STEP * np.cumsum(velocity)
    else:
        pace = 2.0 * np.pi * rng.uniform(0.3, 0.8)
        position = 0.04 + 0.02 * np.sin(pace * time) + 0.008 * np.sin(2.3 * pace * time + 1.0)
        velocity = np.gradient(position, STEP)
    force = np.gradient(velocity, STEP) + 10.0 * np.sign(velocity) + 40.0 * velocity - 5.0
    read = {"piston_position": position + 1e-6 * rng.standard_normal(len(time))}
    read["hydraulic_force"] = disturbed(kind, force, rng)
    bench = parse_bench({"moving_mass": 1.0}, frozenset())
    problem = Problem(check_recording(RawTable("run", time, None, read), bench).segments, bench)
    claims = [
        EffectHypothesis(effect.adapted(bench), FRICTION[effect.label])
        for effect in LIBRARY
        if effect.label in FRICTION
    ]
    problem = problem.reweighted(claims)
    found = fit(problem, claims)
    truth = [value for claim in claims for value in claim.values.values()]
    pairs = zip(intervals(problem, found), truth, strict=True)
    return [(one.low <= value <= one.high, (one.high - one.low) / 2.0 / value) for one, value in pairs]


def print_coverage(runs: int) -> None:
    """Table of the share of intervals that hold the truth."""
    table = Table({"noise": "beside 0.3 N white", "motion": "", **dict.fromkeys(FRICTION, "% held"),
                   "width": "median half width, % of the number"})  # fmt: skip
    kinds = ("white", "coloured, 0.3 s", "coloured, 2 s", "drift, 0.3 N over 1 s", "steps of 1 N",
             "vibration, 2 N at 12 Hz")  # fmt: skip
    for kind in kinds:
        for strokes in (False, True):
            found = np.array([covered(kind, strokes, seed) for seed in range(runs)])
            held = dict(zip(FRICTION, 100.0 * found[:, :, 0].mean(axis=0), strict=True))
            table.add(noise=kind, motion="strokes" if strokes else "sines", **held,
                      width=float(100.0 * np.median(found[:, :, 1])))  # fmt: skip
    print(table.text())


@command(ValueError, OSError)
def main() -> None:
    """Search, print the statistics of the threshold."""
    options = parser("null_simulations", __doc__, parallel=True)
    options.add_argument("--runs", type=bounded_number(1), default=200, help="pairs of recordings (default: 200)")
    options.add_argument("--seed", type=int, default=0, help="of references, gains and noise")
    options.add_argument("--write", type=Path, metavar="FILE", help="keep the trials there and go on from them")
    options.add_argument("--coverage", action="store_true", help="of intervals, on --runs recordings of each kind")
    chosen = options.parse_args()
    if chosen.coverage:
        print_coverage(chosen.runs)
        return
    bench = Bench.nominal()
    pairs = {str(seed): (bench, seed) for seed in range(chosen.seed, chosen.seed + chosen.runs)}
    version = bench.to_mapping(), ENGINE
    trials = results(trial, pairs, chosen, version, chosen.write, label="searching", unit="pair").values()
    table = Table({"noise": "scale of the sensors' noise", "evidence": "of the best claim, BIC", "claim": ""})
    for noise, evidence, claim in trials:
        if evidence is not None:
            table.add(noise=noise, evidence=evidence, claim=claim)
    table.show(chosen.json)
    threshold = SearchSettings().threshold
    false = sum(row["evidence"] > threshold for row in table.rows)
    limit = beta.ppf(0.95, false + 1, len(trials) - false) if false < len(trials) else 1.0  # Clopper and Pearson 1934
    print(f"{len(trials)} pairs of recordings: the threshold in use, {threshold:g}, was passed {false} times; false "
          f"claims: under {limit:.2%} (95 %)")  # fmt: skip


if __name__ == "__main__":
    main()
