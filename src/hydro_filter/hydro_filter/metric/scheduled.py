# SPDX-License-Identifier: Apache-2.0
"""The gain-scheduled metric M(K_p): one for each gain of a table, compiled, as an object, and its file (safetensors).

::

    gain K_p --clip--> table of Cholesky factors --> L(K_p) --> M = L L' + floor I

M is symmetric and positive definite whatever the table holds. It is scheduled by K_p because no single metric holds for
all stable gains: the loop is about s^2 + d s + w^2 with w^2 proportional to K_p, and one quadratic form decays for all
of w^2 in [p, q] only if sqrt(q) - sqrt(p) < d (safety.md). Gains outside of the certified range have one common metric,
the table's last factor. The table holds solutions of Riccati and Lyapunov equations (`metric.design`).

A metric is for a law with one C_1; a file has one or two. Its thresholds were measured with it on held-out runs: the
noise level of a displacement, and the law's integral on stable runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from math import isqrt
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hydro_bridge.files.tensors import LARGEST, UnsoundError, check_shapes
from hydro_bridge.settings import check, quantity
from hydro_bridge.signals import FloatArray
from hydro_filter.metric.design import MetricDesign, MetricParts, design_table
from hydro_filter.model.coordinates import LOOP, LOOP_FIELDS, Q_HYDRAULIC
from hydro_filter.model.loop import coordinates_of
from hydro_filter.model.parts import Loop
from hydro_sim.files import weights
from hydro_sim.files.pairing import MadeFor, made_for
from hydro_sim.files.weights import WeightsError
from hydro_sim.jit import njit
from hydro_sim.model.bench import NOMINAL

STRUCTURE = "metric"
ARRAYS = ("gains", "table")
ANOTHER = "another"
"""Header entry, and prefix of the tensors, of a file's second metric."""
NETWORK = ("w3", "b3")
"""Last layer of the network that some files have on top of the table; the shipped ones' was zero."""
UNFIT = 10.0
"""%, held-out samples that do not decay, beyond which the filter refuses a metric: sound ones have up to 3.2."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds measured on held-out runs by `training.thresholds`."""

    noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """v'Mv of the noise for gains of the certified range."""
    foreign_noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """The same in the metric for all other gains."""
    integral_allowance: Annotated[float, quantity("N/s", 0.0, 1e9)] = NOMINAL.force * 2.0 / 3.0
    """Contribution of the law's integral on stable runs."""


@dataclass(frozen=True, kw_only=True)
class ScheduledMetric:
    """M(K_p) on loop coordinates in units of their scale."""

    gains: FloatArray
    """See `MetricParts`."""
    table: FloatArray
    """See `MetricParts`."""
    floor: float
    """See `MetricParts`."""
    thresholds: Thresholds = Thresholds()
    coordinates: tuple[str, ...] = LOOP_FIELDS
    """Names of the loop's coordinates."""
    training: dict[str, Any] = field(default_factory=dict)
    """Command, settings, held-out violations, digest of the model that it was solved on."""
    made: MadeFor | None = None
    """Bench and model that it is for; None: not recorded in the file."""
    velocity_compensation: float = 1.0
    """C_1 of the law whose loop decays, at C_2 = 1; 1: the paper's."""
    another: ScheduledMetric | None = None
    """The one for another C_1 in the same file."""

    @property
    def certificates(self) -> tuple[ScheduledMetric, ...]:
        """The metric, and the other one in its file."""
        return (self,) if self.another is None else (self, self.another)

    @classmethod
    def designed(cls, loop: Loop, design: MetricDesign) -> ScheduledMetric:
        """Create a metric of the table that is solved at rest."""
        return cls(
            **design_table(loop, design)._asdict(), coordinates=coordinates_of(loop),
            velocity_compensation=design.velocity_compensation,
            thresholds=Thresholds(integral_allowance=float(loop.scale[Q_HYDRAULIC]) * 2.0 / 3.0),
        )  # fmt: skip

    def unfit(self, name: str) -> str:
        """Return why the metric of this file name is no certificate; empty if it is, or where the file says nothing."""
        violated, foreign = (self.training.get(name, 0.0) for name in ("violated", "foreign_violated"))
        if violated <= UNFIT and foreign <= UNFIT:
            return ""
        of = f"{violated:.0f} % of the held-out samples of its range"
        if violated <= UNFIT:
            of = f"{foreign:.0f} % of the held-out samples under its own correction"
        elif where := self.training.get("where", ""):
            of = f"{of} ({where})"
        return (
            f"the metric {name} is not a certificate: {of} do not decay; "
            "make it again on a model that predicts this bench (`ros2 run hydro_sim validate` says how well)"
        )

    @property
    def parts(self) -> MetricParts:
        """Arrays for the kernels."""
        return MetricParts(self.gains, self.table, self.floor)

    def matrix(self, gain: float) -> FloatArray:
        """Return M, of all coordinates, at K_p [1/s]."""
        factor, matrix = scratch(self.parts)
        evaluate(self.parts, float(gain), factor, matrix)
        return matrix

    def save(self, path: str | Path) -> None:
        """Write a weights file."""
        tensors, header = self._contents()
        if self.another is not None:
            others, header[ANOTHER] = self.another._contents()
            tensors |= {f"{ANOTHER}.{name}": tensor for name, tensor in others.items()}
        weights.save(path, tensors, {"structure": STRUCTURE, **header}, self.made)

    def _contents(self) -> tuple[weights.Tensors, dict[str, Any]]:
        header = {
            "floor": self.floor, "coordinates": list(self.coordinates), "thresholds": asdict(self.thresholds),
            "training": self.training, "velocity_compensation": self.velocity_compensation,
        }  # fmt: skip
        return {name: getattr(self, name) for name in ARRAYS}, header

    @classmethod
    def load(cls, path: str | Path | None = None) -> ScheduledMetric:
        """Read a weights file; None: the one shipped with this package. Raises WeightsError."""
        path = path or shipped()
        tensors, header = weights.load(path)
        if header.get("structure") != STRUCTURE:
            raise WeightsError(
                f"{path} has structure {header.get('structure')!r}, not a metric's: `learn_metric` makes one"
            )
        if any(np.any(tensors.get(prefix + name, 0.0)) for name in NETWORK for prefix in ("", f"{ANOTHER}.")):
            raise WeightsError(f"{path} has a network on top of its table: make it again with `learn_metric`")
        try:
            made, other = made_for(header), header.get(ANOTHER)
            another = None if other is None else cls._of(tensors, other, made, f"{ANOTHER}.")
            return replace(cls._of(tensors, header, made), another=another)
        except (KeyError, ValueError, IndexError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path} does not fit its header: {' '.join(str(error).split())}") from error

    @classmethod
    def _of(
        cls, tensors: weights.Tensors, header: Mapping[str, Any], made: MadeFor | None, prefix: str = ""
    ) -> ScheduledMetric:
        arrays = {name: np.asarray(tensors[prefix + name], np.float64) for name in ARRAYS}
        coordinates = tuple(str(name) for name in header.get("coordinates", LOOP_FIELDS))
        entries = len(coordinates) * (len(coordinates) + 1) // 2
        width_of(entries)
        thresholds, c_1 = Thresholds(**header["thresholds"]), float(header.get("velocity_compensation", 1.0))
        _check(arrays, entries, float(header["floor"]), thresholds, c_1)
        return cls(
            floor=float(header["floor"]), thresholds=thresholds, coordinates=coordinates,
            training=dict(header.get("training", {})), made=made, velocity_compensation=c_1, another=None, **arrays,
        )  # fmt: skip


def _check(arrays: Mapping[str, FloatArray], entries: int, floor: float, thresholds: Thresholds, c_1: float) -> None:
    """Raise ValueError if these do not form a metric."""
    if not 0.0 <= c_1 <= 1.0:
        raise UnsoundError(f"velocity_compensation is {c_1:g}: it is a share")
    gains = arrays["gains"]
    check_shapes(arrays, {"table": (len(gains) + 1, entries)})
    check(thresholds)
    if gains.ndim != 1 or not (np.diff(gains) > 0.0).all():
        raise UnsoundError("gains do not rise")
    if not 0.0 < floor < LARGEST:
        raise UnsoundError(f"floor is {floor:g}: M is definite for a floor above 0 only")


def shipped() -> Path:
    """Return the metric shipped with this package."""
    return Path(str(resources.files("hydro_filter") / "data" / "default_metric.safetensors"))


def width_of(entries: int) -> int:
    """Return the number of coordinates of a factor with so many entries.

    Raises
    ------
    ValueError
        No number of coordinates has so many.
    """
    width = (isqrt(8 * entries + 1) - 1) // 2
    if width * (width + 1) != 2 * entries or width < LOOP:
        raise ValueError(f"{entries} entries are no Cholesky factor of {LOOP} coordinates or more")
    return width


def scratch(parts: MetricParts) -> tuple[FloatArray, FloatArray]:
    """Allocate `factor` and `matrix` of `evaluate`."""
    entries = parts.table.shape[1]
    return np.zeros(entries), np.zeros((width_of(entries), width_of(entries)))


@njit(inline="always")
def uncertified(parts, gain):
    """Return whether K_p [1/s] is outside of the certified range; true for NaN."""
    return not parts.gains[0] <= gain <= parts.gains[-1]


@njit(inline="always")
def evaluate(parts, gain, factor, matrix):
    """Write the factor's entries and M for K_p [1/s], the factors interpolated linearly between the table's gains."""
    rows, outside = len(parts.gains), uncertified(parts, gain)
    if outside or rows == 1:
        row = parts.table[rows if outside else 0]
        for i in range(len(factor)):
            factor[i] = row[i]
    else:
        place = (gain - parts.gains[0]) / (parts.gains[1] - parts.gains[0])
        low = min(int(place), rows - 2)
        share = place - low
        for i in range(len(factor)):
            factor[i] = (1.0 - share) * parts.table[low, i] + share * parts.table[low + 1, i]
    if len(matrix) == LOOP:  # a count that the compiler knows
        _square(LOOP, factor, parts.floor, matrix)
    else:
        _square(len(matrix), factor, parts.floor, matrix)


@njit(inline="always")
def _square(count, factor, floor, matrix):
    """M = L L' + floor I."""
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for k in range(j + 1):
                total += factor[i * (i + 1) // 2 + k] * factor[j * (j + 1) // 2 + k]
            matrix[i, j] = matrix[j, i] = total
        matrix[i, i] += floor
