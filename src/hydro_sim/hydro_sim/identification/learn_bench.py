# SPDX-License-Identifier: Apache-2.0
"""`learn --structure bench`: a bench file in, the same one with its effects' parameters learnt out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from hydro_bridge.cli.console import Table, UserError
from hydro_bridge.signals import PLANT_FIELDS
from hydro_sim.files import recordings
from hydro_sim.files.recordings import READING_COLUMNS
from hydro_sim.identification import bench_learning
from hydro_sim.identification.bench_learning import HORIZON, Result
from hydro_sim.learned.any_model import BENCH_FILES, is_bench
from hydro_sim.model.bench import Bench

STRUCTURE = "bench"
"""What `--structure` calls it."""

FITTING = ("bags", "out", "structure", "bench", "windows", "seed", "json")
"""Options that mean something here."""

GOOD = 1.3
"""Times the noise, to which predictions may leave it without a word."""

COLUMNS = {
    "parameter": "",
    "before": "in the bench file",
    "learnt": "",
    "low": "of its 95 % interval, as far as the model is whole",
    "high": "",
    "unit": "",
    "seen": "whether the recordings say more of it than the bench file",
}


def run(options: argparse.Namespace, said: Collection[str]) -> None:
    """Learn, print, write.

    Raises
    ------
    UserError
        Options that mean nothing here, or no bench file.
    ValueError
        See `bench_learning.learn`.
    """
    strange = [f"--{name.replace('_', '-')}" for name in said if name not in FITTING]
    if strange:
        raise UserError(f"{', '.join(strange)} means nothing for --structure {STRUCTURE}")
    if not options.bench:
        raise UserError(f"--structure {STRUCTURE} learns what a bench file names: name one by --bench")
    if options.windows < 1 or options.seed < 0:
        raise UserError("--windows needs 1 or more, --seed 0 or more")
    if not is_bench(options.out):
        raise UserError(f"--out {options.out}: a bench file's name ends in {' or '.join(BENCH_FILES)}")
    bench = Bench.load(options.bench)
    if not bench.terms:
        raise UserError(f"{options.bench} names no effects: list them under 'effects', or let `diagnose` find them")
    data = recordings.split(recordings.load(options.bags))
    result = bench_learning.learn(
        bench, data, count=options.windows, seed=options.seed, report=lambda text: print(text, file=sys.stderr)
    )
    _table(result).show(options.json)
    judgement = judged(result)
    _write(result, Path(options.out), judgement, data.digests)
    print(f"{options.out}: {judgement}")


def judged(result: Result) -> str:
    """How good it is, in a sentence."""
    ratios = result.left / result.noise
    names = (PLANT_FIELDS[column] for column in READING_COLUMNS)
    each = ", ".join(f"{name} {ratio:.2f}" for name, ratio in zip(names, ratios, strict=True))
    told = f"{HORIZON}-sample predictions leave {result.over_noise:.2f} times the noise ({each})"
    if unfit := stated(result).unfit:
        return f"{told}; NOT fit for the filter: {unfit}"
    if np.max(ratios) > GOOD:
        return f"{told}; more than {GOOD:g} times where it is more hints at an effect that the file does not name"
    return told


def stated(result: Result) -> Bench:
    """The learnt bench, with what is known of it."""
    known = {"bench": result.bench.digest, "samples": HORIZON, "over_noise": round(result.over_noise, 4)}
    return replace(result.bench, learned=known)


def _table(result: Result) -> Table:
    table = Table(COLUMNS, title="parameters of the bench file's effects")
    for one in result.parameters:
        table.add(
            parameter=one.name, before=one.before, learnt=one.value, low=one.low, high=one.high, unit=one.unit,
            seen="yes" if one.seen else "no",
        )  # fmt: skip
    return table


def _write(result: Result, out: Path, judgement: str, digests: dict[str, str]) -> None:
    lines = [
        "bench.yaml with its effects' parameters learnt by `ros2 run hydro_sim learn`; SI units.", judgement,
        *(f"from {name}, samples {digest[:12]}" for name, digest in digests.items()),
    ]  # fmt: skip
    lines += [f"{one.name}: 95 % within {one.low:.6g} and {one.high:.6g} {one.unit}" for one in result.parameters]
    head = "".join(f"# {line}\n" for line in lines)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(head + yaml.safe_dump(stated(result).to_mapping(), sort_keys=False), encoding="utf-8")
