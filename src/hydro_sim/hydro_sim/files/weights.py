# SPDX-License-Identifier: Apache-2.0
"""Weights on disk: a safetensors file of a few kB with a JSON header. Never pickle.

The header's one entry `hydro` holds: format, structure, fields of the structure, `made_for` (`files.pairing`), and
`training`: command, seed, settings, errors reached.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as serialize

from hydro_core.files.atomic import write_atomic
from hydro_core.files.tensors import InvalidTensorError, check_finite
from hydro_sim.files.pairing import HEADER_KEY, Provenance

FORMAT = 1
Tensors = dict[str, npt.NDArray[Any]]


class WeightsError(ValueError):
    """Invalid weights file; the message is one sentence."""


def save(path: str | Path, tensors: Tensors, header: dict[str, Any], provenance: Provenance | None = None) -> None:
    """Write tensors, header and provenance; create missing folders."""
    if provenance is not None:
        header = {**header, HEADER_KEY: asdict(provenance)}
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    arrays = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    content = serialize(arrays, metadata={"hydro": json.dumps({"format": FORMAT, **header})})
    write_atomic(Path(path), content)


def load(path: str | Path) -> tuple[Tensors, dict[str, Any]]:
    """Load tensors and header of a weights file.

    Raises WeightsError if the file is missing, is no safetensors file, is not of this format, or has invalid values.
    """
    try:
        with safe_open(str(path), framework="numpy") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (OSError, SafetensorError) as error:
        reason = "there is no such file" if not Path(path).exists() else " ".join(str(error).split())
        raise WeightsError(f"{path} cannot be read as weights: {reason}") from error
    try:
        header = json.loads(metadata["hydro"])
        kind = header["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(f"{path} holds no weights: its header has no readable entry 'hydro'") from error
    if kind != FORMAT:
        raise WeightsError(f"{path} is of format {kind}, this version reads format {FORMAT}: make it again")
    try:
        check_finite(tensors)
    except InvalidTensorError as error:
        raise WeightsError(f"{path} is damaged: {error}") from None
    return tensors, header
