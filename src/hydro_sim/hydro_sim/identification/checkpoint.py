# SPDX-License-Identifier: Apache-2.0
"""Checkpoint of `learn`: progress of the loop, the model, and the options."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from hydro_bridge.files.tensors import check_numbers
from hydro_sim.files.recordings import DataError
from hydro_sim.identification import adam
from hydro_sim.identification.training import Settings
from hydro_sim.learned.model import STRUCTURES, Model

_PROGRESS, _MODEL = "progress.", "model."


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A training under way."""

    progress: adam.Progress
    model: Model
    """The model as the loop began with it: the constants of a structured one are identified already."""
    settings: Settings
    asked: Mapping[str, Any] = field(default_factory=dict)
    """The other options, as JSON types: recordings' digests, the bench file."""

    def save(self, path: Path) -> None:
        """Write the checkpoint; the old one stays until the new one is complete. Missing folders are created."""
        arrays = {_PROGRESS + name: array for name, array in self.progress.arrays().items()}
        arrays |= {_MODEL + name: array for name, array in self.model.tensors().items()}
        about = {"model": self.model.header(), "settings": asdict(self.settings), "asked": dict(self.asked)}
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = path.with_name(path.name + ".new")
        whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        save_file(whole, str(scratch), metadata={"hydro": json.dumps(about)})
        scratch.replace(path)

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """Read a checkpoint; raises DataError if it is none."""
        try:
            with safe_open(str(path), framework="np") as file:
                about = json.loads(file.metadata()["hydro"])
                arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no mapping
            check_numbers(_part(arrays, _MODEL))
            check_numbers({name: arrays[_PROGRESS + name] for name in ("parameters", "first_moment", "second_moment")})
            header = about["model"]
            return cls(
                progress=adam.Progress.of(_part(arrays, _PROGRESS)),
                model=STRUCTURES[header["structure"]].from_file(_part(arrays, _MODEL), header),
                settings=_settings(about["settings"]),
                asked=about["asked"],
            )
        except Exception as error:  # safetensors has errors of its own
            raise DataError(f"{path} is no checkpoint of a training: {' '.join(str(error).split())}") from error


def _part(arrays: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _settings(values: dict[str, Any]) -> Settings:
    return Settings(**{**values, "hidden": tuple(values["hidden"]), "adam": adam.Settings(**values["adam"])})
