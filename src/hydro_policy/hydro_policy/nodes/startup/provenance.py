# SPDX-License-Identifier: Apache-2.0
"""Provenance of a recording: the bench file, and digests of all weights involved."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_policy.sac.policy import load_policy
from hydro_sim.files.weights import shipped

if TYPE_CHECKING:
    from hydro_filter.controller.factory import FilterChoice


def bench_file(given: Path | None) -> Path:
    """Return the path of the bench.yaml in use: the one given, or the nominal one of hydro_sim."""
    return given or Path(str(resources.files("hydro_sim") / "data" / "bench.yaml"))


def weights(plant: str, bench: Path | None, policies: Iterable[Path], model: Path | None = None) -> list[str]:
    """Return key=value words: SHA-256 of the simulation's model and of each policy that the recording may contain.

    The sim node runs the given model, else the analytic model of a bench file, else the weights shipped with it.
    """
    words = [f"policy_sha256_{path.stem}={_digest(path)}" for path in policies if path.is_file()]
    if plant == "sim":
        file = model or (None if bench else shipped())
        words.append("model=analytic" if file is None else f"model_sha256={_digest(file)}")
    return words


def of_filter(choice: FilterChoice) -> list[str]:
    """Return key=value words: SHA-256 of the filter's metric and of its prediction model, or that it has none."""
    return [f"filter_{name}_sha256={_digest(path)}" for name, path in choice.files.items()] or [
        f"filter_metric={choice.metric}"
    ]


def describe_policy(path: Path) -> str:
    """Describe a file's policy: the digest of its weights, as in diagnostics, and of the file, as in recordings.

    Raises
    ------
    ValueError
        The file is not a policy.
    """
    return f"policy {path}: weights {load_policy(path)[0].digest()}, SHA-256 {_digest(path)}"


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()
