# SPDX-License-Identifier: Apache-2.0
"""Learned metric as an object, its thresholds, and its file (safetensors).

M(x, K_p) is that of `metric.network`, for a law with one C_1; a file has one or two. Its thresholds were measured with
it on held-out runs: the noise level of a displacement, the law's integral on stable runs, and the contraction rate of
the training.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hydro_bridge.files.tensors import LARGEST, UnsoundError, check_shapes
from hydro_bridge.settings import check, quantity
from hydro_bridge.signals import FloatArray
from hydro_filter.metric import network
from hydro_filter.metric.design import MetricDesign, design_table
from hydro_filter.metric.network import HIDDEN, INPUTS, MetricParts, metric_value, width_of
from hydro_filter.model.coordinates import LOOP_FIELDS
from hydro_filter.model.loop import coordinates_of
from hydro_filter.model.parts import Loop
from hydro_filter.model.state import STATES, state_scale
from hydro_sim.files import weights
from hydro_sim.files.pairing import MadeFor, made_for
from hydro_sim.files.weights import WeightsError
from hydro_sim.model.bench import Bench
from hydro_sim.model.hydraulics import rest_state
from hydro_sim.neural import mlp

STRUCTURE = "metric"
ARRAYS = ("center", "scale", "low", "high", "gains", "table")
ANOTHER = "another"
"""Header entry, and prefix of the tensors, of a file's second metric."""
UNFIT = 10.0
"""%, held-out samples that do not decay, beyond which the filter refuses a metric: sound ones have up to 3.2."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds measured on held-out runs by `training.levels`."""

    noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """v'Mv of the noise for gains of the certified range."""
    foreign_noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """The same in the metric for all other gains."""
    integral_allowance: Annotated[float, quantity("N/s", 0.0, 1e6)] = 200.0
    """Contribution of the law's integral on stable runs."""


@dataclass(frozen=True, kw_only=True)
class LearnedMetric:
    """M(x, K_p) on loop coordinates."""

    flat: FloatArray
    """The network's weights."""
    hidden: tuple[int, int]
    center: FloatArray
    """Shape (8,), of x."""
    scale: FloatArray
    """Shape (8,), of x."""
    low: FloatArray
    """Shape (8,), lower bounds of the x that the network was trained on."""
    high: FloatArray
    """Shape (8,), upper bounds."""
    gains: FloatArray
    """K_p [1/s] of the table."""
    table: FloatArray
    """Cholesky factors, shape (n + 1, 36) for eight coordinates."""
    floor: float
    thresholds: Thresholds = Thresholds()
    coordinates: tuple[str, ...] = LOOP_FIELDS
    """Names of the loop's coordinates."""
    training: dict[str, Any] = field(default_factory=dict)
    """Command, settings, losses reached, digest of the model that it was trained on."""
    made: MadeFor | None = None
    """Bench and model that it is for; None: not recorded in the file."""
    velocity_compensation: float = 1.0
    """C_1 of the law whose loop decays, at C_2 = 1; 1: the paper's."""
    another: LearnedMetric | None = None
    """The one for another C_1 in the same file."""

    @property
    def certificates(self) -> tuple[LearnedMetric, ...]:
        """The metric, and the other one in its file."""
        return (self,) if self.another is None else (self, self.another)

    @classmethod
    def designed(
        cls, loop: Loop, bench: Bench, design: MetricDesign, *, hidden: tuple[int, int] = HIDDEN, seed: int = 0
    ) -> LearnedMetric:
        """Create a metric of the solved table only: the network's last layer is zero."""
        solved = design_table(loop, design)
        center = np.zeros(STATES)
        center[4:7] = rest_state(bench.constants()[0])[:3]
        flat = mlp.initial(np.random.default_rng(seed), INPUTS, hidden, solved.table.shape[1], last=0.0)
        return cls(
            flat=flat, hidden=hidden, center=center, scale=state_scale(bench),
            low=np.full(STATES, -np.inf), high=np.full(STATES, np.inf),
            gains=solved.gains, table=solved.table, floor=solved.floor, coordinates=coordinates_of(loop),
            velocity_compensation=design.velocity_compensation,
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
            f"the metric {name} is no certificate: {of} do not decay; "
            "make it anew on a model that predicts this bench (`ros2 run hydro_sim validate` says how well)"
        )

    @property
    def parts(self) -> MetricParts:
        """Arrays for the kernels."""
        layers = mlp.layers(self.flat, INPUTS, self.hidden, self.table.shape[1])
        ends = self.low, self.high
        return MetricParts(layers, self.center, self.scale, *ends, self.gains, self.table, self.floor)

    def matrix(self, x: FloatArray, gain: float) -> FloatArray:
        """Return M, of all coordinates, at x (8,) [SI units] and K_p [1/s]."""
        return self.matrix_and_rate(x, np.zeros(STATES), gain)[0]

    def matrix_and_rate(self, x: FloatArray, state_rate: FloatArray, gain: float) -> tuple[FloatArray, FloatArray]:
        """Return M and M' [1/s] along x' (8,) [SI units per s]."""
        value = metric_value(self.parts)
        network.evaluate(self.parts, x, state_rate, gain, value)
        return value.matrix, value.rate

    def with_weights(self, flat: FloatArray) -> LearnedMetric:
        """Return the same metric with other weights."""
        return replace(self, flat=np.asarray(flat, np.float64).copy())

    def save(self, path: str | Path) -> None:
        """Write a weights file."""
        tensors, header = self._contents()
        if self.another is not None:
            others, header[ANOTHER] = self.another._contents()
            tensors |= {f"{ANOTHER}.{name}": tensor for name, tensor in others.items()}
        weights.save(path, tensors, {"structure": STRUCTURE, **header}, self.made)

    def _contents(self) -> tuple[weights.Tensors, dict[str, Any]]:
        views = mlp.layers(self.flat, INPUTS, self.hidden, self.table.shape[1])._asdict()
        arrays = {name: getattr(self, name) for name in ARRAYS}
        header = {
            "hidden": list(self.hidden), "activation": "relu", "floor": self.floor,
            "coordinates": list(self.coordinates), "thresholds": asdict(self.thresholds), "training": self.training,
            "normalization": "(x - center) / scale, K_p / 100 or 0, foreign 0 or 1; out: Cholesky factor by rows",
            "velocity_compensation": self.velocity_compensation,
        }  # fmt: skip
        return {**views, **arrays}, header

    @classmethod
    def load(cls, path: str | Path | None = None) -> LearnedMetric:
        """Read a weights file; None: the one shipped with this package. Raises WeightsError."""
        path = path or shipped()
        tensors, header = weights.load(path)
        if header["structure"] != STRUCTURE:
            raise WeightsError(
                f"{path} has structure {header['structure']!r}, not a metric's: `learn_metric` makes one"
            )
        try:
            made, other = made_for(header), header.get(ANOTHER)
            another = None if other is None else cls._of(tensors, other, made, f"{ANOTHER}.")
            return replace(cls._of(tensors, header, made), another=another)
        except (KeyError, ValueError, IndexError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path} does not fit its header: {' '.join(str(error).split())}") from error

    @classmethod
    def _of(
        cls, tensors: weights.Tensors, header: Mapping[str, Any], made: MadeFor | None, prefix: str = ""
    ) -> LearnedMetric:
        hidden = (int(header["hidden"][0]), int(header["hidden"][1]))
        flat = np.concatenate([np.asarray(tensors[prefix + name], np.float64).ravel() for name in mlp.Layers._fields])
        arrays = {name: np.asarray(tensors[prefix + name], np.float64) for name in ARRAYS}
        coordinates = tuple(str(name) for name in header.get("coordinates", LOOP_FIELDS))
        entries = len(coordinates) * (len(coordinates) + 1) // 2
        width_of(entries)
        mlp.layers(flat, INPUTS, hidden, entries)
        c_1 = float(header.get("velocity_compensation", 1.0))
        _check(arrays, entries, float(header["floor"]), Thresholds(**header["thresholds"]), c_1)
        return cls(
            flat=flat, hidden=hidden, floor=float(header["floor"]), thresholds=Thresholds(**header["thresholds"]),
            coordinates=coordinates, training=dict(header.get("training", {})), made=made,
            velocity_compensation=c_1, another=None, **arrays,
        )  # fmt: skip


def _check(arrays: Mapping[str, FloatArray], entries: int, floor: float, thresholds: Thresholds, c_1: float) -> None:
    """Raise ValueError if these do not form a metric."""
    if not 0.0 <= c_1 <= 1.0:
        raise UnsoundError(f"velocity_compensation is {c_1:g}: it is a share")
    gains = arrays["gains"]
    state, table = (STATES,), (len(gains) + 1, entries)
    check_shapes(arrays, {"center": state, "scale": state, "low": state, "high": state, "table": table})
    check(thresholds)
    if not (arrays["scale"] > 0.0).all():
        raise UnsoundError("scale holds a value that is not above 0")
    if not (arrays["low"] <= arrays["high"]).all():
        raise UnsoundError("a bound in low lies above the one in high")
    if gains.ndim != 1 or not (np.diff(gains) > 0.0).all():
        raise UnsoundError("gains do not rise")
    if not 0.0 < floor < LARGEST:
        raise UnsoundError(f"floor is {floor:g}: M is definite for a floor above 0 only")


def shipped() -> Path:
    """Return the metric shipped with this package."""
    return Path(str(resources.files("hydro_filter") / "data" / "default_metric.safetensors"))
