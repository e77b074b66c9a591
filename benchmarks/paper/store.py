# SPDX-License-Identifier: Apache-2.0
"""Results by piece: one JSON file each, so that a run that was interrupted goes on where it was.

The results that came with the program lie in `results/SIZE.jsonl`, one line each: they count as made, so that the
hours of a full run can be spread over machines and days. What a piece leaves beside its result (weights, agents) is not
among them and is made again where a piece that is still to come needs it.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import yaml

from hydro_core.files.atomic import write_atomic
from hydro_sim.emulator.truth.config import TruthConfig, load_truth, profile

RESULTS = Path(__file__).parent / "results"
"""What came with the program."""
PRINTED: Mapping[str, Any] = yaml.safe_load((Path(__file__).parent / "paper.yaml").read_text(encoding="utf-8"))
"""paper.yaml."""

LOSSES = ("one-step", "squared", "printed")
"""Of the network model, the quickest first: H = 1; each error squared, as meant; their sum squared, as printed."""
TIMES = (1, 10, 30, 70)
"""Samples after which f_l is looked at."""
CASES = ("stable", "unstable", "negative", "positive", "high")
"""Of Table val_cont: the paper's two rows, strictly negative and positive gains, and K_p above 100."""
FILTERS = ("none", "ours", "paper-short", "paper-long")
"""Bypassed; the shipped one; the paper's after 3 epochs and after many."""
AUTHORITIES = ("paper", "wide")
OWN_TRUTH, OWN_BENCH = (Path(__file__).parent / f"own_row_{kind}.yaml" for kind in ("truth", "bench"))
"""The bench with the paper's printed row III, as the emulator has it and as a bench file."""
OWN_GAINS = (90.0, 105.0, 120.0, 150.0, 200.0, 300.0)
"""K_p that run behind the paper's filter there, K_i 15."""

Result = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Size:
    """How much is run."""

    name: str
    seeds: int
    """Of everything that is learnt, and of the runs that judge it."""
    model_epochs: int
    metric_epochs: int
    """Of the long training at most; the paper's 3 are run by themselves, too."""
    rollouts: int
    """For the metric, of 3 s."""
    validation_seconds: float
    simulated_episodes: int
    bench_episodes: int


FULL = Size(
    name="full", seeds=5, model_epochs=1000, metric_epochs=200, rollouts=400, validation_seconds=18.0,
    simulated_episodes=160, bench_episodes=160,
)  # fmt: skip
QUICK = Size(
    name="quick", seeds=2, model_epochs=50, metric_epochs=20, rollouts=30, validation_seconds=4.0,
    simulated_episodes=8, bench_episodes=2,
)  # fmt: skip


class Store:
    """The results of one size, in `folder/NAME.json`.

    `folder`: where; made if there is none. `size`: what is run; a result of another size is never taken for one of
    this. `shipped`: folder of results that were made elsewhere, one file of lines for each size; None: only what is in
    `folder`.
    """

    def __init__(self, folder: Path, size: Size, shipped: Path | None = None) -> None:
        self.folder, self.size = folder / size.name, size
        self.folder.mkdir(parents=True, exist_ok=True)
        file = None if shipped is None else shipped / f"{size.name}.jsonl"  # of `ship`
        lines = file.read_text(encoding="utf-8").splitlines() if file is not None and file.is_file() else []
        self._shipped: dict[str, Result] = {row.pop("name"): row for row in map(json.loads, lines)}
        self._places = folder, shipped
        self._inside = 0.0  # s of CPU of pieces that the present one had made; theirs, not its own

    @property
    def bench(self) -> str:
        """`own`: the one with the paper's row III; `default`: the emulator's default truth."""
        return "own" if self.size.name.endswith("-own") else "default"

    @property
    def own(self) -> Store:
        """The results on the bench with the paper's row III, of this size."""
        folder, shipped = self._places
        return Store(folder, replace(self.size, name=f"{self.size.name}-own"), shipped)

    def piece(self, name: str, make: Callable[[], Result], beside: Path | None = None) -> Result:
        """The result of this name, made and kept if it is not there yet, or if what it left `beside` it is gone."""
        if (kept := self.kept(name)) is not None and (beside is None or beside.exists()):
            return kept
        print(f"paper, {self.size.name}: {name}", file=sys.stderr, flush=True)
        began, around, self._inside = _cpu(), self._inside, 0.0
        result = _plain(make())
        spent = _cpu() - began
        result |= {"cpu": round(spent - self._inside, 1), "made": date.today().isoformat(), "size": asdict(self.size)}
        self._inside = around + spent
        write_atomic(self._file(name), (json.dumps(result, indent=1, allow_nan=False) + "\n").encode())
        return result

    def kept(self, name: str) -> Result | None:
        """What is there of this name; None: nothing, or of a size of other numbers."""
        file = self._file(name)
        found = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else self._shipped.get(name)
        return found if found is not None and found["size"] == asdict(self.size) else None

    def names(self) -> list[str]:
        """Of all pieces that are there."""
        named = {file.stem for file in self.folder.glob("*.json")} | set(self._shipped)
        return sorted(name for name in named if self.kept(name) is not None)

    def ship(self, folder: Path) -> Path:
        """Write all that is there into one file of lines, to come with the program; returns the file."""
        folder.mkdir(parents=True, exist_ok=True)
        lines = (json.dumps({"name": name, **(self.kept(name) or {})}, allow_nan=False) + "\n" for name in self.names())
        write_atomic(file := folder / f"{self.size.name}.jsonl", "".join(lines).encode())
        return file

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.json"


def truth(bench: str) -> TruthConfig:
    """The truth of `Store.bench`."""
    return load_truth(OWN_TRUTH) if bench == "own" else profile("default")


def _cpu() -> float:
    """s of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def _plain(value: Any) -> Any:
    """The same with null for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
