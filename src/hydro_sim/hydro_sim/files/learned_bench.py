# SPDX-License-Identifier: Apache-2.0
"""Learned benches: bench files that `learn` or `diagnose` made, and the one that comes with this package.

A bench file states its own numbers; the metric or the policy made for both states the box that belongs to it
(`files.pairing`). The shipped one belongs to the nominal box.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_sim.files.pairing import BoxIdentity, MadeFor, mismatch, raise_if_mismatched
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_sim.model.plant import AnalyticPlant

BENCH_FILES = (".yaml", ".yml")


def shipped() -> Path:
    """Path of the learned bench shipped with this package."""
    return Path(str(resources.files("hydro_sim") / "data" / "learned_bench.yaml"))


def is_bench_file(path: str | Path) -> bool:
    """Return whether a file's name is a bench file's."""
    return Path(path).suffix in BENCH_FILES


def read(path: str | Path | None = None) -> Bench:
    """Read a bench file; None: the shipped one. Raises ValueError: it is invalid."""
    return Bench.load(path or shipped())


def load_model(path: str | Path | None = None) -> Bench:
    """Load a bench that a certificate may rest on; None: the shipped one.

    Raises ValueError: as `read`, or the file states that it predicts the bench badly.
    """
    bench = read(path)
    if bench.unfit:
        raise ValueError(f"{path}: {bench.unfit}")
    return bench


def make_plant(path: str | Path | None = None, *, noise: float = 1.0) -> AnalyticPlant:
    """Return a plant of a learned bench (raises as `read`)."""
    from hydro_sim.model.plant import AnalyticPlant  # numba: not needed to find a file
    from hydro_sim.model.sensors import Sensors

    bench = read(path)
    return AnalyticPlant(bench, noise=noise, settings=Sensors.of_size(bench.size))


def digest(path: str | Path | None = None) -> str:
    """Digest that identifies a learned bench: of the bench file's keys and numbers."""
    return read(path).digest


def box_mismatch(path: str | Path | None, box: BoxIdentity, remedy: str) -> str:
    """Return why a learned bench is not of a box, in one sentence; empty if it is: the user's own is of any."""
    if path is not None and Path(path) != shipped():
        return ""
    made = MadeFor(box=Bench.nominal().digest)
    return mismatch(f"the model {shipped().name}", made, box, remedy)


def require_match(path: str | Path | None, box: BoxIdentity, remedy: str) -> None:
    """Raise PairingError if a learned bench is not of a box."""
    raise_if_mismatched(box_mismatch(path, box, remedy))
