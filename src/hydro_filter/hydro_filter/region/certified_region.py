# SPDX-License-Identifier: Apache-2.0
"""A certified region: box of states, gains and benches over which a metric is proved to contract, and its file.

The file is stored next to the metric, METRIC.region.json; `benchmarks.verify_region` repeats its proof.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydro_core.files.atomic import write_atomic
from hydro_core.signals import SAMPLE_PERIOD, FloatArray

Bounds = tuple[float, float]

TOLERANCED_PARAMETERS = (
    "valve_gain", "bulk_modulus", "dead_volume_a", "dead_volume_b", "spring_stiffness", "supply_pressure",
    "spool_bandwidth",
)  # fmt: skip
"""Parameters of a bench with a tolerance, as ratios to those of the bench file; `dead_time` has one in s."""

ASSUMPTIONS = (
    "The bench has the structure of the bench file: two chambers of constant bulk modulus with laminar leakage, sharp "
    "edges of the valve, a spool and a load cell of second order, a mass, a linear spring, end stops out of reach.",
    "The states of both trajectories, and of those between them, stay within the box over the sample, and the spool "
    "does not change its side of zero: g differs on both sides.",
    "Both trajectories have the same weighted sum of the pressures, which the loop hardly moves, and the same "
    "integral.",
    "The force law's current is within the valve's limit, above the floor of g, and acts at the sample at which it was "
    "computed, held for 1 ms, without jitter.",
    "A disturbance is constant within a sample: dry friction up to its level, what an overlap takes from the opening, "
    "noise up to four standard deviations, the encoder's step.",
    "Piston areas, stroke, mass, viscous friction, the spool's damping, load cell and leakage are those of the file.",
)


def region_path(metric: Path, *, compensated: bool) -> Path:
    """Return the region's file for a metric's: METRIC.region.json or METRIC.compensated.region.json."""
    return metric.with_suffix(".compensated.region.json" if compensated else ".region.json")


def delay_samples(dead_time: float) -> int:
    """Return the number of samples of a dead time [s], rounded up."""
    return math.ceil(dead_time / SAMPLE_PERIOD - 1e-9)


@dataclass(frozen=True, kw_only=True)
class ToleranceCell:
    """Part of the tolerances, with a metric common to all benches within."""

    tolerances: dict[str, Bounds]
    gains: tuple[float, ...]
    """K_p [1/s] of the matrices; M is interpolated linearly between them."""
    matrices: FloatArray
    """M, shape (gains, n, n); v'Mv = 1 is the boundary of the set that the disturbances do not leave."""


@dataclass(frozen=True, kw_only=True)
class CertifiedRegion:
    """Certified region with its metric: (F + G K)' M(K_p+) (F + G K) <= exp(-2 lambda T) M(K_p) everywhere in it."""

    believed: dict[str, float]
    """Parameters of the force law's bench."""
    bench: dict[str, float]
    """Parameters of the bench file."""
    tolerances: dict[str, Bounds]
    """Ratios of the bench's parameters to those of the file; `dead_time` [s]."""
    states: dict[str, Bounds]
    """Ranges of the states."""
    velocity_compensation: Bounds
    """C_1."""
    proportional_gain: Bounds
    """K_p [1/s]."""
    gain_rate: float
    """1/s^2, fastest change of K_p."""
    disturbances: dict[str, float]
    weights: tuple[float, ...]
    """Share of each direction of the disturbance in v'Mv, summing up to 1 at most."""
    contraction_rate: float
    """lambda [1/s]."""
    tube_rate: float
    """1/s, lambda or more: the rate at which inequality and tube are proved."""
    tube: float
    """N, steady bound on the error of f_l that the disturbances leave."""
    scale: tuple[float, ...]
    """Units of the coordinates."""
    cells: tuple[ToleranceCell, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    """Force of the run, seconds of the proof, tubes, share of the run's states inside, digests."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates: eight, and one for each started millisecond of dead time."""
        return 8 + delay_samples(self.tolerances["dead_time"][1])

    @property
    def directions(self) -> list[int]:
        """Indices of the disturbances with a weight."""
        return [i for i, weight in enumerate(self.weights) if weight > 0.0]

    @property
    def decay(self) -> float:
        """exp(-2 lambda T) at the rate of the proof."""
        return math.exp(-2.0 * self.tube_rate * SAMPLE_PERIOD)

    def save(self, path: Path) -> None:
        """Write the region to a JSON file."""
        content = {**asdict(self), "assumed": ASSUMPTIONS, "period": SAMPLE_PERIOD}
        for cell in content["cells"]:
            cell["matrices"] = cell["matrices"].tolist()
        write_atomic(path, json.dumps(content, indent=1).encode())

    @classmethod
    def load(cls, path: Path) -> CertifiedRegion:
        """Read a region's file. Raises ValueError: it is not of a region."""
        try:
            return cls.from_mapping(json.loads(path.read_text(encoding="utf-8")))
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is no statement of a region: {error}") from error

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any]) -> CertifiedRegion:
        """Create a region from the content of its file."""
        pairs = {name: {key: tuple(value) for key, value in content[name].items()} for name in ("tolerances", "states")}
        cells = tuple(
            ToleranceCell(
                tolerances={key: tuple(value) for key, value in one["tolerances"].items()},
                gains=tuple(one["gains"]), matrices=np.asarray(one["matrices"], np.float64),
            )
            for one in content["cells"]
        )  # fmt: skip
        names = set(cls.__dataclass_fields__) - {"cells"}
        rest: dict[str, Any] = {name: tuple(v) if isinstance(v := content[name], list) else v for name in names}
        return cls(**(rest | pairs | {"cells": cells}))
