# SPDX-License-Identifier: Apache-2.0
"""Null simulations: recordings with nothing missing, searched without a threshold, to measure evidence by chance.

    python -m benchmarks.null_simulations --runs 200 --write null_simulations.json

The assumed bench is recorded and searched for the one claim that explains it best: its evidence is what the choice
among all hypotheses makes of noise. With a threshold above that evidence, nothing is claimed. With --write, finished
trials are saved, and the same command resumes from them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import exp, inf, log
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import beta
from threadpoolctl import threadpool_limits

from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress, writable
from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_diagnosis.blind_benchmark.blind import engine
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import simulated_recording
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.outcome import SearchSettings
from hydro_diagnosis.selection.search import Search
from hydro_sim.model.bench import Bench


@dataclass(frozen=True)
class Trial:
    """Two recordings in which nothing is missing, searched without a threshold."""

    noise: float
    """Scale of the sensors' noise."""
    evidence: float
    """Evidence of the best claim [BIC], below 0 where it does not pay its price; -infinity if none is large enough."""
    claim: str


@dataclass(frozen=True)
class Calibration:
    """False-claim statistics of a threshold."""

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
        recording = simulated_recording(bench, reference, gains=gains, seconds=20.0, noise=noise, seed=seed * 10 + k)
        segments += recording.segments
    settings = SearchSettings(threshold=-1e3, most=1)
    with threadpool_limits(1, "blas"):
        search = Search(Problem(segments, bench), [one.adapted(bench) for one in CANDIDATES], settings)
        search.run()
    if not search.steps:
        return Trial(noise, -inf, "none")
    return Trial(noise, -search.steps[0].score, search.steps[0].label)


def calibrated(trials: Sequence[Trial], threshold: float) -> Calibration:
    """Compute the false-claim statistics of a threshold from trials."""
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


def load(path: Path, bench: Bench) -> dict[int, Trial]:
    """Load the trials by seed that `save` has written; none if there is no such file.

    Raises
    ------
    UserError
        If the trials are of another bench or version of the diagnosis and cannot be combined, or the file holds none.
    """
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return _of(content, path, bench)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} holds no null simulations: write to another") from error


def _of(content: Mapping[str, Any], path: Path, bench: Bench) -> dict[int, Trial]:
    if content["bench"] != bench.to_mapping():
        raise UserError(f"{path} holds trials of another bench: write to another file")
    if content["engine"] != engine():
        raise UserError(f"{path} holds trials of another version of the diagnosis: write to another file")
    return {
        entry["seed"]: Trial(entry["noise"], -inf if entry["evidence"] is None else entry["evidence"], entry["claim"])
        for entry in content["trials"]
    }


def save(path: Path, bench: Bench, trials: Mapping[int, Trial], threshold: float) -> None:
    """Write trials by seed and the threshold's statistics; the file is complete at any time."""
    entries: list[dict[str, Any]] = [{"seed": seed, **asdict(one)} for seed, one in sorted(trials.items())]
    for entry in entries:
        entry["evidence"] = entry["evidence"] if entry["evidence"] > -inf else None
    outcome = asdict(calibrated(list(trials.values()), threshold))
    content = {"outcome": outcome, "engine": engine(), "bench": bench.to_mapping(), "trials": entries}
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".{path.name}")
    scratch.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    os.replace(scratch, path)


def _searched(bench: Bench, seeds: Sequence[int], jobs: int) -> Iterator[tuple[int, Trial]]:
    runs = Parallel(jobs, return_as="generator")(delayed(trial)(bench, seed) for seed in seeds)
    yield from zip(seeds, progress(runs, total=len(seeds), label="searching", unit="run"), strict=True)


def _show(trials: Sequence[Trial], threshold: float, rate: float, json_file: str | None) -> None:
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
    outcome = calibrated(trials, threshold)
    print(
        f"{outcome.trials} pairs of recordings: the threshold in use, {outcome.threshold:g}, was passed "
        f"{outcome.false} times; false claims: under {outcome.limit:.2%} (95 %), {outcome.expected:.2g} by the tail of "
        f"the evidence; a rate of {rate:g} needs {needed(trials, rate):.1f}"
    )


def parser() -> argparse.ArgumentParser:
    """The command line."""
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.null_simulations",
        description="Search recordings in which nothing is missing, and say how much evidence a claim needs.",
    )
    options.add_argument("--bench", help="bench.yaml (default: the nominal bench)")
    options.add_argument("--runs", type=int, default=200, help="pairs of recordings (default: 200)")
    options.add_argument("--seed", type=int, default=0, help="of references, gains and noise")
    options.add_argument("--rate", type=float, default=1e-3, help="of false claims to allow (default: 0.001)")
    options.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    options.add_argument(
        "--write", type=writable, metavar="FILE", help="keep the trials there, as JSON, and go on from them"
    )
    add_json_argument(options)
    return options


def run(arguments: Sequence[str]) -> int:
    """Search, print the statistics of the threshold; 130 after Ctrl-C before the first trial."""
    chosen = parser().parse_args(arguments)
    if min(chosen.runs, chosen.jobs) < 1:
        raise UserError(f"--runs {chosen.runs} --jobs {chosen.jobs}: there must be one of each at least")
    bench = Bench.load(chosen.bench) if chosen.bench else Bench.nominal()
    threshold = SearchSettings().threshold
    wanted = range(chosen.seed, chosen.seed + chosen.runs)
    file = Path(chosen.write) if chosen.write else None
    before = load(file, bench) if file else {}
    trials = {seed: before[seed] for seed in wanted if seed in before}
    try:
        for seed, one in _searched(bench, [seed for seed in wanted if seed not in trials], chosen.jobs):
            trials[seed] = one
            if file:
                save(file, bench, {**before, **trials}, threshold)
    except KeyboardInterrupt:
        print("interrupted: what follows rests on the trials that were finished", file=sys.stderr)
    if not trials:
        return 130
    _show(list(trials.values()), threshold, chosen.rate, chosen.json)
    return 0


@command(ValueError, OSError)
def main() -> int:
    """Entry point."""
    return run(sys.argv[1:])


if __name__ == "__main__":
    main()
