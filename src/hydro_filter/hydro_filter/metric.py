# SPDX-License-Identifier: Apache-2.0
"""The gain-scheduled metric M(K_p): its design at rest, the object and its file (safetensors).

::

    gain K_p --clip--> table of Cholesky factors --> L(K_p) --> M = L L' + floor I      firmware/hydro/loop_filter.h

M is symmetric and positive definite whatever the table holds. It is scheduled by K_p because no single metric holds for
all stable gains: the loop is about s^2 + d s + w^2 with w^2 proportional to K_p, and one quadratic form decays for all
of w^2 in [p, q] only if sqrt(q) - sqrt(p) < d (filter.md). Gains outside of the certified range have one common metric,
the table's last factor.

In the certified range of K_p, the metric must decay along the frozen loop F + G K without a correction: P solves the
discrete Lyapunov equation of that loop, sped up by a part of its own decay. Outside, the correction closes the loop, so
that the metric is that of the best correction: P solves the discrete Riccati equation, and the loop under its feedback
decays at some 20 1/s. Both are for the bench at rest; training and certificate must show that they hold
elsewhere.

A metric is for a law with one C_1; a file has one or two. Its thresholds were measured in simulated runs: the
noise level of a displacement, and the law's integral on stable runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.linalg import cholesky, solve_discrete_are, solve_discrete_lyapunov

from hydro_core.files.tensors import MAX_MAGNITUDE, InvalidTensorError, check_shapes
from hydro_core.settings import check, quantity
from hydro_core.signals import FloatArray
from hydro_filter.model.coordinates import LOOP_FIELDS, LOOP_SIZE, Q_HYDRAULIC, Q_LOAD
from hydro_filter.model.loop import Loop, closing_current, coordinate_names, make_samples, rest_measurement
from hydro_filter.model.records import FILTER_DTYPE, library, linearize, make_record
from hydro_sim.box.firmware import address_of
from hydro_sim.files import weights
from hydro_sim.files.pairing import Provenance, parse_provenance
from hydro_sim.files.weights import WeightsError
from hydro_sim.model.bench import NOMINAL


@dataclass(frozen=True, kw_only=True)
class MetricDesign:
    """Design of a scheduled metric: range of gains, decay rate, weights."""

    gain_low: Annotated[float, quantity("1/s", 1.0, 1e6)] = 10.0
    """The certified range's lower end."""
    gain_high: Annotated[float, quantity("1/s", 1.0, 1e6)] = 95.0
    """The certified range's upper end: the rollouts turn unstable some 20 1/s above."""
    gain_share: Annotated[float, quantity("-", 0.1, 1.0)] = 0.8
    """The upper end is at most this share of the gain at which the loop at rest decays no more."""
    gain_step: Annotated[float, quantity("1/s", 0.5, 50.0)] = 5.0
    """Least step between the table's gains."""
    velocity_compensation: Annotated[float, quantity("-", 0.0, 1.0)] = 1.0
    """C_1 of the law, at C_2 = 1."""
    own_decay: Annotated[float, quantity("-", 0.0, 0.95)] = 0.3
    """Share of a loop's own decay that its metric is solved for."""
    foreign_weights: tuple[Annotated[float, quantity("-", 1e-9, 1e9)], ...] = (
        1e-2, 1e-2, 1e-2, 1.0, 1e-2, 1.0, 1e-2, 1e-2,
    )  # fmt: skip
    """Of the loop coordinates' squares in the Riccati equation, each above 0; the Lyapunov equations have ones."""
    added_weight: Annotated[float, quantity("-", 1e-9, 1e9)] = 1e-2
    """The same of coordinates that a bench file adds."""
    effort: Annotated[float, quantity("-", 1e-4, 100.0)] = 1e-2
    """Weight of the correction's square in it, in units of 0.14 of the valve's current."""
    floor: Annotated[float, quantity("-", 1e-9, 1e-2)] = 1e-6
    """Smallest eigenvalue of M, over its largest entry."""


GAIN_TABLE_STEPS_MAX = 48
"""Largest number of steps of the table: a wider range of gains gets wider steps."""
SCANNED_GAINS = (1.0, 2.0, 5.0, *(10.0 * place for place in range(1, 21)))
"""K_p [1/s] at which `require_stable_gain` evaluates the loop."""


def linearize_at_rest(
    loop: Loop, proportional_gain: float, velocity_compensation: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the linearization F, G, K of the loop at rest with the valve closed, shapes (n, n), (n,), (n,)."""
    rest = linearize(
        loop.record,
        make_samples(
            rest_measurement(loop)[None], nominal=1e-9, current=closing_current(loop), k_p=proportional_gain,
            c_1=velocity_compensation,
        ),
    )  # fmt: skip
    return rest.transition[0], rest.input_vector[0], rest.feedback[0]


def closed_loop_at_rest(loop: Loop, proportional_gain: float, velocity_compensation: float = 1.0) -> FloatArray:
    """Return F + G K at rest with the valve closed, shape (n, n)."""
    transition, input_vector, feedback = linearize_at_rest(loop, proportional_gain, velocity_compensation)
    return transition + np.outer(input_vector, feedback)


def spectral_radius(closed: FloatArray) -> float:
    """Return the largest magnitude of a loop's eigenvalues: below 1 it decays."""
    return float(np.abs(np.linalg.eigvals(closed)).max())


def solve_lyapunov(closed: FloatArray, decay_share: float) -> FloatArray:
    """Return the solution P, shape (n, n), of the discrete Lyapunov equation for a share of the loop's decay rate.

    Raises ValueError if the loop does not decay.
    """
    slowest = spectral_radius(closed)
    if slowest >= 1.0:
        raise ValueError("a metric is wanted of a loop that does not decay: the certified range of K_p is too wide")
    sped = closed / slowest**decay_share
    return np.asarray(solve_discrete_lyapunov(sped.T, np.eye(len(closed))))


def require_stable_gain(loop: Loop, velocity_compensation: float = 1.0) -> None:
    """Raise ValueError if the linearized loop at rest is stable at no gain: then no metric exists."""
    if any(spectral_radius(closed_loop_at_rest(loop, k_p, velocity_compensation)) < 1.0 for k_p in SCANNED_GAINS):
        return
    valve, dead = 1e3 * loop["spool_age"], 1e3 * loop["delay"]
    raise ValueError(
        f"no gain has a certificate: the loop, with {valve:.1f} ms of valve lag and {dead:.1f} ms of dead time, decays "
        f"at no K_p from {SCANNED_GAINS[0]:g} to {SCANNED_GAINS[-1]:g} 1/s"
    )


def limit_to_stable_range(loop: Loop, design: MetricDesign) -> MetricDesign:
    """Return the design with its range of K_p limited to a share of the gain at which the loop at rest turns unstable.

    Dry friction and overlap, which the linearized loop leaves out, hold a real bench still at gains beyond that: its
    rollouts are stable although its loop is not. The share equals the range's reserve below unstable rollouts.

    Raises ValueError if the loop does not decay at the range's lower end, or the reserve leaves no range.
    """
    low, share = design.gain_low, design.gain_share
    high = design.gain_high / share
    for gain in np.arange(low, high, max(1.0, (high - low) / 600)):
        if spectral_radius(closed_loop_at_rest(loop, float(gain), design.velocity_compensation)) >= 1.0:
            break
    else:
        return design
    if gain == low:
        end = f"at K_p = {low:g} 1/s, the lower end of the certified range"
        raise ValueError(f"the loop does not decay {end}: take a bench file of this box, or a faster valve")
    if not share * gain > low:
        raise ValueError(f"no gain has a certificate: rollouts decay from {low:g} 1/s on, the loop up to {gain:g} 1/s")
    return replace(design, gain_high=min(design.gain_high, float(share * gain)))


def solve_riccati(loop: Loop, design: MetricDesign) -> tuple[FloatArray, FloatArray]:
    """Return Riccati solution P, shape (n, n), and feedback K [A], shape (n,), of the optimal correction at rest."""
    transition, input_vector, _ = linearize_at_rest(loop, design.gain_low)
    unit = 0.14 * loop.box_bench.valve_current_max
    g, weights = unit * input_vector, [*design.foreign_weights, *[design.added_weight] * (len(loop.scale) - LOOP_SIZE)]
    weight = np.asarray(solve_discrete_are(transition, g[:, np.newaxis], np.diag(weights), np.array([[design.effort]])))
    feedback = -(g @ weight @ transition) / (design.effort + g @ weight @ g)
    return weight, unit * feedback


def cholesky_entries(weight: FloatArray) -> FloatArray:
    """Return the entries of a metric's lower Cholesky factor, row by row, shape (36,) for 8 coordinates."""
    return np.asarray(cholesky(weight, lower=True)[np.tril_indices(len(weight))])


STRUCTURE = "metric"
ARRAY_NAMES = ("gains", "table")
SECOND_METRIC_KEY = "another"
"""Header entry, and prefix of the tensors, of a file's second metric."""
VIOLATION_LIMIT = 10.0
"""%, held-out samples that do not decay, beyond which the filter refuses a metric: sound ones have up to 3.2."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Thresholds measured in simulated runs by `training.data`."""

    noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """v'Mv of the noise for gains of the certified range."""
    foreign_noise_size: Annotated[float, quantity("-", 0.0, 1e6)] = 0.0
    """The same in the metric for all other gains."""
    integral_allowance: Annotated[float, quantity("N/s", 0.0, 1e9)] = NOMINAL.force * 2.0 / 3.0
    """Contribution of the law's integral on stable runs."""


@dataclass(frozen=True, kw_only=True)
class ScheduledMetric:
    """Gain-scheduled metric M(K_p) on scaled loop coordinates."""

    gains: FloatArray
    """K_p [1/s] of the table's factors but the last, evenly spaced, shape (n,); the ends are the certified range."""
    table: FloatArray
    """Cholesky factors by rows, shape (n + 1, 36) for eight coordinates; the last is for uncertified gains."""
    floor: float
    """Smallest eigenvalue of M, above 0."""
    thresholds: Thresholds = Thresholds()
    coordinates: tuple[str, ...] = LOOP_FIELDS
    """Names of the loop's coordinates."""
    training: dict[str, Any] = field(default_factory=dict)
    """Command, settings, held-out violations, digest of the model that it was solved on."""
    provenance: Provenance | None = None
    """Bench and model that it is for; None: not recorded in the file."""
    velocity_compensation: float = 1.0
    """C_1 of the law whose loop decays, at C_2 = 1; 1: the paper's."""
    another: ScheduledMetric | None = None
    """Metric for another C_1 in the same file; None: there is none."""

    @property
    def all_metrics(self) -> tuple[ScheduledMetric, ...]:
        """All metrics of the file: this one and, if there is one, that for another C_1."""
        return (self,) if self.another is None else (self, self.another)

    @classmethod
    def from_design(cls, loop: Loop, design: MetricDesign) -> ScheduledMetric:
        """Solve a design's metrics for the loop at rest, each scaled to 1 along f_l; raises as `solve_lyapunov`."""
        low, high, step, c_1 = design.gain_low, design.gain_high, design.gain_step, design.velocity_compensation
        wide = high - low > GAIN_TABLE_STEPS_MAX * step
        gains = np.linspace(low, high, GAIN_TABLE_STEPS_MAX + 1) if wide else np.arange(low, high + 0.5 * step, step)
        solved = [solve_lyapunov(closed_loop_at_rest(loop, gain, c_1), design.own_decay) for gain in gains]
        solved.append(solve_riccati(loop, design)[0])
        return cls(
            gains=np.asarray(gains, np.float64),
            table=np.array([cholesky_entries(one / one[Q_LOAD, Q_LOAD]) for one in solved]),
            floor=design.floor,
            coordinates=coordinate_names(loop),
            velocity_compensation=c_1,
            thresholds=Thresholds(integral_allowance=float(loop.scale[Q_HYDRAULIC]) * 2.0 / 3.0),
        )

    def validity_error(self, name: str) -> str:
        """Return an error message if too many held-out samples violated the metric of file `name`; else empty."""
        kinds = {"violated": "of its range", "foreign_violated": "under its own correction"}
        violated, samples = max((self.training.get(key, 0.0), kind) for key, kind in kinds.items())
        if violated <= VIOLATION_LIMIT:
            return ""
        beyond = f"{violated:.0f} % of the held-out samples {samples} do not decay"
        return f"the metric {name} is not a certificate, {beyond}: make it on a model that predicts this bench"

    @property
    def firmware_fields(self) -> dict[str, Any]:
        """Fields of hydro_loop_filter (firmware/hydro/loop_filter.h) except `table`."""
        gains = self.gains
        return {
            "rows": len(gains), "gain_low": gains[0], "gain_high": gains[-1], "floor": self.floor,
            "gain_step": gains[1] - gains[0] if len(gains) > 1 else 1.0,
            "velocity_compensation": self.velocity_compensation,
        }  # fmt: skip

    def matrix(self, gain: float) -> FloatArray:
        """Return M(K_p), shape (n, n), at K_p = `gain` [1/s]."""
        width = len(self.coordinates)
        record = make_record(FILTER_DTYPE, self.firmware_fields | {"loop.coordinates": width}, {"table": self.table})
        matrix = np.empty((width, width))
        library().hydro_c_filter_metric(address_of(record), gain, self.velocity_compensation, address_of(matrix))
        return matrix

    def save(self, path: str | Path) -> None:
        """Write the metric to a safetensors file."""
        tensors: weights.Tensors = {}
        headers: list[dict[str, Any]] = []
        for prefix, one in zip(("", f"{SECOND_METRIC_KEY}."), self.all_metrics, strict=False):
            tensors |= {prefix + name: getattr(one, name) for name in ARRAY_NAMES}
            headers.append({
                "floor": one.floor, "coordinates": list(one.coordinates), "thresholds": asdict(one.thresholds),
                "training": one.training, "velocity_compensation": one.velocity_compensation,
            })  # fmt: skip
        header, *second = headers
        if second:
            header[SECOND_METRIC_KEY] = second[0]
        weights.save(path, tensors, {"structure": STRUCTURE, **header}, self.provenance)

    @classmethod
    def load(cls, path: str | Path | None = None) -> ScheduledMetric:
        """Read a metric from its file; None: the shipped one. Raises WeightsError."""
        path = path or shipped_metric()
        tensors, header = weights.load(path)
        if header.get("structure") != STRUCTURE:
            raise WeightsError(f"{path} holds no metric: `learn_metric` makes one")
        try:
            provenance, other = parse_provenance(header), header.get(SECOND_METRIC_KEY)
            another = None if other is None else cls._of(tensors, other, provenance, f"{SECOND_METRIC_KEY}.")
            return replace(cls._of(tensors, header, provenance), another=another)
        except (KeyError, ValueError, IndexError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path} does not fit its header: {' '.join(str(error).split())}") from error

    @classmethod
    def _of(
        cls, tensors: weights.Tensors, header: Mapping[str, Any], provenance: Provenance | None, prefix: str = ""
    ) -> ScheduledMetric:
        """Return one metric of a file; raises ValueError if its tensors and its header do not form one."""
        arrays = {name: np.asarray(tensors[prefix + name], np.float64) for name in ARRAY_NAMES}
        coordinates, gains = tuple(str(name) for name in header["coordinates"]), arrays["gains"]
        width, thresholds = len(coordinates), Thresholds(**header["thresholds"])
        floor, c_1 = float(header["floor"]), float(header["velocity_compensation"])
        check_shapes(arrays, {"table": (len(gains) + 1, width * (width + 1) // 2)})
        check(thresholds)
        if width < LOOP_SIZE or not (
            0.0 <= c_1 <= 1.0 and 0.0 < floor < MAX_MAGNITUDE and (np.diff(gains) > 0.0).all()
        ):
            raise InvalidTensorError("coordinates, gains, floor or velocity_compensation are not those of a metric")
        return cls(
            floor=floor, thresholds=thresholds, coordinates=coordinates, training=dict(header["training"]),
            provenance=provenance, velocity_compensation=c_1, gains=gains, table=arrays["table"],
        )  # fmt: skip


def shipped_metric() -> Path:
    """Return the path of the metric shipped with this package."""
    return Path(str(resources.files("hydro_filter") / "data" / "default_metric.safetensors"))
