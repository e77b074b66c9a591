# SPDX-License-Identifier: Apache-2.0
"""A learned bench, with its training region and the facts of its training."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.files.tensors import check_shapes
from hydro_sim.files import weights
from hydro_sim.files.pairing import MadeFor, made_for
from hydro_sim.files.weights import WeightsError
from hydro_sim.learned.region import Region
from hydro_sim.structured.model import StructuredModel

UNITS = {"state": ["N", "N/s", "N", "N/s", "Pa", "Pa", "m", "m/s"], "current": "A", "sample": "1e-3 s"}


@dataclass(frozen=True, kw_only=True)
class Learned:
    """Contents of a weights file."""

    model: StructuredModel
    region: Region
    training: dict[str, Any] = field(default_factory=dict)
    """Recordings' digests, command, seed, settings, code version, errors reached."""
    made: MadeFor | None = None
    """The box that it was made for; None: the file does not state one."""

    def save(self, path: str | Path) -> None:
        """Write a weights file."""
        tensors = {**self.model.tensors(), "region_center": self.region.center, "region_whiten": self.region.whiten}
        weights.save(path, tensors, {**self.model.header(), "units": UNITS, "training": self.training}, self.made)

    @classmethod
    def load(cls, path: str | Path | None = None) -> Learned:
        """Read a weights file; None: the one that comes with this package. Raises WeightsError."""
        path = path or weights.shipped()
        tensors, header = weights.load(path)
        if header["structure"] != StructuredModel.name:
            raise WeightsError(f"{path} has structure {header['structure']!r}, not {StructuredModel.name!r}")
        try:
            model = StructuredModel.from_file(tensors, header)
            region = Region(
                center=np.asarray(tensors["region_center"], np.float64),
                whiten=np.asarray(tensors["region_whiten"], np.float64),
            )
            check_shapes(tensors, {name: a.shape for name, a in model.tensors().items() if name in tensors})
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise WeightsError(f"{path} does not fit its header: {' '.join(str(error).split())}") from error
        return cls(model=model, region=region, training=header.get("training", {}), made=made_for(header))
