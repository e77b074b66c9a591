# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis calibrate`: how much evidence a claim needs, so that none is made where nothing is missing.

Recordings of the bench as believed are searched without a threshold, for the one claim that explains them best: its
evidence is what choosing among all hypotheses makes of noise. Above a threshold that exceeds it nothing is claimed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from hydro_bridge.console import Table, add_json_argument, command, progress
from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.outcome import SearchSettings
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.rehearse import rehearsal
from hydro_diagnosis.search import Search
from hydro_sim.bench import Bench

SHIPPED = Path(__file__).parent / "data" / "calibration.json"
"""The calibration on which the default threshold rests."""


@dataclass(frozen=True)
class Trial:
    """Two recordings in which nothing is missing, searched without a threshold."""

    noise: float
    """Scale of the sensors' noise."""
    evidence: float
    """Of the best claim [BIC], below 0 where it does not pay its price; minus infinity if none is large enough."""
    claim: str


@dataclass(frozen=True)
class Calibration:
    """What a threshold is worth."""

    threshold: float
    """BIC."""
    trials: int
    false: int
    """Trials with more evidence than the threshold."""
    limit: float
    """95 % upper limit of the rate of false claims, from the count alone (Clopper and Pearson 1934)."""
    expected: float
    """The same rate by the tail of the trials' evidence above its median, taken as exponential."""


def trial(bench: Bench, seed: int) -> Trial:
    """Record the bench as believed under two drawn references, gains and one noise, and search."""
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
        recording = rehearsal(bench, reference, gains=gains, seconds=20.0, noise=noise, seed=seed * 10 + k)
        segments += recording.segments
    settings = SearchSettings(threshold=-1e3, most=1)
    with threadpool_limits(1, "blas"):
        search = Search(Problem(segments, bench), [one.adapted(bench) for one in CANDIDATES], settings)
        search.run()
    if not search.steps:
        return Trial(noise, -inf, "none")
    return Trial(noise, -search.steps[0].score, search.steps[0].label)


def calibrated(trials: Sequence[Trial], threshold: float) -> Calibration:
    """What a threshold is worth by these trials."""
    false = sum(one.evidence > threshold for one in trials)
    share, middle, excess = _tail(trials)
    expected = share * exp(-max(threshold - middle, 0.0) / excess) if share else 0.0
    return Calibration(threshold, len(trials), false, _upper(false, len(trials)), expected)


def needed(trials: Sequence[Trial], rate: float) -> float:
    """Threshold [BIC] at which the tail of the trials' evidence has fallen to a rate; at least the largest seen."""
    share, middle, excess = _tail(trials)
    if not share:
        return 0.0
    return max(0.0, *(one.evidence for one in trials), middle + excess * log(max(share / rate, 1.0)))


def _tail(trials: Sequence[Trial]) -> tuple[float, float, float]:
    """Share of trials above the median of what evidence there is, that median, and the mean excess over it."""
    found = np.array([one.evidence for one in trials if one.evidence > -inf])
    if len(found) < 4:
        return 0.0, 0.0, 1.0
    middle = float(np.median(found))
    above = found[found > middle]
    return len(above) / len(trials), middle, float(np.mean(above - middle))


def _upper(hits: int, count: int) -> float:
    """95 % upper limit of a share."""
    return float(beta.ppf(0.95, hits + 1, count - hits)) if hits < count else 1.0


@command()
def main() -> int:
    """Run the calibration and print what the threshold is worth."""
    options = argparse.ArgumentParser(
        prog="calibrate",
        description="Search recordings in which nothing is missing, and say how much evidence a claim needs.",
    )
    options.add_argument("--bench", help="bench.yaml (default: the nominal bench)")
    options.add_argument("--runs", type=int, default=200, help="pairs of recordings (default: 200)")
    options.add_argument("--seed", type=int, default=0, help="of references, gains and noise")
    options.add_argument("--rate", type=float, default=1e-3, help="of false claims to allow (default: 0.001)")
    options.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    options.add_argument("--write", type=Path, metavar="FILE", help="write the trials and the outcome as JSON")
    add_json_argument(options)
    chosen = options.parse_args(sys.argv[1:])
    bench = Bench.load(chosen.bench) if chosen.bench else Bench.nominal()
    trials: list[Trial] = []
    runs = Parallel(chosen.jobs, return_as="generator")(
        delayed(trial)(bench, chosen.seed + k) for k in range(chosen.runs)
    )
    try:
        for one in progress(runs, total=chosen.runs, label="searching", unit="run"):
            trials.append(one)
    except KeyboardInterrupt:
        print("interrupted: what follows rests on the trials that were finished", file=sys.stderr)
    if not trials:
        return 130
    _show(trials, chosen.json)
    outcome = calibrated(trials, SearchSettings().threshold)
    print(
        f"{outcome.trials} pairs of recordings: the threshold in use, {outcome.threshold:g}, was passed "
        f"{outcome.false} times; false claims: under {outcome.limit:.2%} (95 %), {outcome.expected:.2g} by the tail of "
        "the evidence; "
        f"a rate of {chosen.rate:g} needs {needed(trials, chosen.rate):.1f}"
    )
    if chosen.write:
        content = {"command": "ros2 run hydro_diagnosis calibrate " + " ".join(sys.argv[1:]), **vars(outcome)}
        content["evidence"] = [round(one.evidence, 2) if one.evidence > -inf else None for one in trials]
        chosen.write.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0


def _show(trials: Sequence[Trial], json_file: str | None) -> None:
    table = Table(
        {
            "noise": "scale of the sensors' noise",
            "evidence": "of the best claim, BIC",
            "claim": "what would be claimed",
        }
    )
    for one in trials:
        if one.evidence > -inf:
            table.add(noise=one.noise, evidence=one.evidence, claim=one.claim)
    table.show(json_file)


if __name__ == "__main__":
    main()
