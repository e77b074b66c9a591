# SPDX-License-Identifier: Apache-2.0
"""A calibration: null simulations in parallel, saved as they finish, and the table of their evidence."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path

from joblib import Parallel, delayed

from hydro_bridge.cli.console import Table, UserError, progress
from hydro_diagnosis.calibration.null_simulations import Trial, calibrated, keep, kept, needed, trial
from hydro_diagnosis.selection.outcome import SearchSettings
from hydro_sim.model.bench import Bench


def calibrate(chosen: argparse.Namespace) -> int:
    """Calibrate and print the threshold's statistics; return 130 after Ctrl-C before the first trial."""
    if min(chosen.runs, chosen.jobs) < 1:
        raise UserError(f"--runs {chosen.runs} --jobs {chosen.jobs}: there must be one of each at least")
    bench = Bench.load(chosen.bench) if chosen.bench else Bench.nominal()
    threshold = SearchSettings().threshold
    wanted = range(chosen.seed, chosen.seed + chosen.runs)
    file = Path(chosen.write) if chosen.write else None
    before = kept(file, bench) if file else {}
    trials = {seed: before[seed] for seed in wanted if seed in before}
    try:
        for seed, one in _searched(bench, [seed for seed in wanted if seed not in trials], chosen.jobs):
            trials[seed] = one
            if file:
                keep(file, bench, {**before, **trials}, threshold)
    except KeyboardInterrupt:
        print("interrupted: what follows rests on the trials that were finished", file=sys.stderr)
    if not trials:
        return 130
    _show(list(trials.values()), threshold, chosen.rate, chosen.json)
    return 0


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
