# SPDX-License-Identifier: Apache-2.0
"""Learned benches: bench files of `learn` or `diagnose`, and the one shipped with this package.

A bench file does not state its box: the metric or the policy made for both does (`files.pairing`). The shipped one
belongs to the nominal box.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_sim.files.pairing import BoxIdentity, Provenance, mismatch, raise_if_mismatched
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_sim.model.plant import AnalyticPlant

BENCH_FILES = (".yaml", ".yml")


def shipped_bench() -> Path:
    """Return the path of the learned bench shipped with this package."""
    return Path(str(resources.files("hydro_sim") / "data" / "learned_bench.yaml"))


def read(path: str | Path | None = None) -> Bench:
    """Read a bench file; None: the shipped one. Raises ValueError: it is invalid."""
    return Bench.load(path or shipped_bench())


def load_model(path: str | Path | None = None) -> Bench:
    """Load a bench of sufficient prediction quality for a certificate; None: the shipped one.

    Raises ValueError: as `read`, or the file states a prediction error that is too large.
    """
    bench = read(path)
    if bench.rejection_reason:
        raise ValueError(f"{path}: {bench.rejection_reason}")
    return bench


def make_plant(path: str | Path | None = None, *, noise: float = 1.0) -> AnalyticPlant:
    """Return a plant of a learned bench (raises as `read`)."""
    from hydro_sim.model.plant import AnalyticPlant  # numba: not needed to find a file
    from hydro_sim.model.sensors import Sensors

    bench = read(path)
    return AnalyticPlant(bench, noise=noise, settings=Sensors.of_size(bench.size))


def digest(path: str | Path | None = None) -> str:
    """Return the digest of a learned bench's keys and values."""
    return read(path).digest


def box_mismatch(path: str | Path | None, box: BoxIdentity, remedy: str) -> str:
    """Return an error message if the shipped bench, if used, is for another box; empty if not, and for other files."""
    if path is not None and Path(path) != shipped_bench():
        return ""
    provenance = Provenance(box=Bench.nominal().digest)
    return mismatch(f"the model {shipped_bench().name}", provenance, box, remedy)


def require_match(path: str | Path | None, box: BoxIdentity, remedy: str) -> None:
    """Raise PairingError if the shipped learned bench, if used, was made for another box."""
    raise_if_mismatched(box_mismatch(path, box, remedy))
