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
from hydro_core.files.tensors import check_finite
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
            header: dict[str, Any] = json.loads((file.metadata() or {})["hydro"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
        check_finite(tensors)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        reason = "there is no such file" if not Path(path).exists() else " ".join(str(error).split())
        raise WeightsError(f"{path} cannot be read as weights: {reason}") from error
    if header.get("format") != FORMAT:
        raise WeightsError(f"{path} is not of format {FORMAT}, which this version reads: make it again")
    return tensors, header
