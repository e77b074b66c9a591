# SPDX-License-Identifier: Apache-2.0
"""`learn --structure bench`: fits the parameters of a bench file's effects and writes the file anew."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import yaml

from hydro_bridge.cli.console import Table, UserError
from hydro_bridge.files.atomic import write_whole
from hydro_sim.files import recordings
from hydro_sim.identification import bench_learning
from hydro_sim.identification.bench_learning import Result
from hydro_sim.learned.any_model import BENCH_FILES, is_bench_file
from hydro_sim.model.bench import Bench

STRUCTURE = "bench"
"""Its name for `--structure`."""

FITTING = ("bags", "out", "structure", "bench", "windows", "seed", "json")
"""Options that apply here."""

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
    """Learn the bench, print its quality, and write it.

    Raises
    ------
    UserError
        If an option does not apply here, or there is no bench file.
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
    if not is_bench_file(options.out):
        raise UserError(f"--out {options.out}: a bench file's name ends in {' or '.join(BENCH_FILES)}")
    bench = Bench.load(options.bench)
    if not bench.terms:
        raise UserError(f"{options.bench} names no effects: list them under 'effects', or let `diagnose` find them")
    data = recordings.split(recordings.load(options.bags))
    result = bench_learning.learn(
        bench, data, count=options.windows, seed=options.seed, report=lambda text: print(text, file=sys.stderr)
    )
    _table(result).show(options.json)
    judgement = result.quality.told()
    _write(result, Path(options.out), judgement, data.digests)
    print(f"{options.out}: {judgement}")


def with_quality(result: Result) -> Bench:
    """The learned bench with its measured quality."""
    return replace(result.bench, learned={"bench": result.bench.digest, **result.quality.to_mapping()})


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
    write_whole(out, (head + yaml.safe_dump(with_quality(result).to_mapping(), sort_keys=False)).encode())
