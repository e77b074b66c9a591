# SPDX-License-Identifier: Apache-2.0
"""Loading of a bench model of any kind: weights of `learn`, or a bench file with named effects.

A bench file states its own numbers; the metric or the policy made for both states the box that belongs to it
(`files.pairing`).
"""

from __future__ import annotations

from pathlib import Path

from hydro_sim.files import weights
from hydro_sim.files.pairing import BoxIdentity, mismatch, raise_if_mismatched
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant
from hydro_sim.structured.model import StructuredModel

BENCH_FILES = (".yaml", ".yml")


def is_bench_file(path: str | Path | None) -> bool:
    """Return whether a file's name is a bench file's; None is the shipped model."""
    return path is not None and Path(path).suffix in BENCH_FILES


def load_model(path: str | Path | None) -> StructuredModel | Bench:
    """Load a model that admits a certificate; None: the shipped one.

    Raises
    ------
    WeightsError
        If the file is missing or unreadable.
    ValueError
        If the bench file is invalid, or states that it predicts the bench badly.
    """
    if path is not None and is_bench_file(path):
        bench = Bench.load(path)
        if bench.unfit:
            raise ValueError(f"{path}: {bench.unfit}")
        return bench
    return Learned.load(path).model


def make_plant(path: str | Path | None, *, noise: float = 1.0) -> Plant:
    """Return a plant of any model (raises as `load_model`)."""
    if path is not None and is_bench_file(path):
        return AnalyticPlant(Bench.load(path), noise=noise)
    return LearnedPlant(path, noise=noise)


def digest(path: str | Path) -> str:
    """Digest that identifies a model: of its tensors, or of the bench file's keys and numbers."""
    return Bench.load(path).digest if is_bench_file(path) else weights.digest(path)


def require_match(path: str | Path | None, box: BoxIdentity, remedy: str) -> None:
    """Raise PairingError if learned weights do not match a box; a bench file matches any."""
    if not is_bench_file(path):
        named = Path(path or weights.shipped())
        raise_if_mismatched(mismatch(f"the model {named.name}", Learned.load(path).made, box, remedy))
