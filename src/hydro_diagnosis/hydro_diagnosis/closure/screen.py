# SPDX-License-Identifier: Apache-2.0
"""Laws and tables over what was recorded, and what each gains on held-out blocks beside a fit, to first order.

The responses of all laws, at every start value of their further parameters, are computed once. Beside any fit, products
with its residual and its columns give four-fold cross-validation (`evidence`) of each law alone in closed form. Only
the best few are fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.effects.kernels import held_lag
from hydro_diagnosis.estimation.fit import SHORTEST, Fit
from hydro_diagnosis.estimation.problem import CHANNELS, FOLDS, Layout, Problem
from hydro_diagnosis.model.responses import Responses
from hydro_sim.model import grammar
from hydro_sim.model.laws import SIGN_VELOCITY, Law
from hydro_sim.model.tables import SETTLING, Table

INSIDE = 0.1
"""Percentiles of its variable that a table leaves out at either end."""
QUANTILES = (0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95)
"""Quantiles of a threshold's signal at which thresholds are tried."""
EDGE = 0.02
"""Share of a threshold's signal that is left on either side of it."""
SLOWEST = 3.0 * SIGN_VELOCITY
"""Least threshold of a speed [m/s]: drag up to less is dry friction, drag above less is viscous friction."""
PROMISING = 4
"""Laws that a joint search with names tries, beside names alone and beside the laws that were found first."""


def laws(problem: Problem) -> list[Claim]:
    """Laws that these recordings can show, their thresholds within what was recorded."""
    found = [placed for law in (*grammar.LAWS, *grammar.COMPOSITIONS) if (placed := _placed(law, problem)) is not None]
    return [one for effect in found for one in _nothing(effect)]


def _placed(law: Law, problem: Problem) -> Closure | None:
    effect = closure(law, problem.bench)
    if law.gate and _visible(effect, problem):
        signal, side = law.gate
        share = float(np.mean(side * _recorded(problem, signal) > 0.0))
        return effect if EDGE < share < 1.0 - EDGE else None  # else it is the law without the gate, or nothing
    over = next((number.over for number in law.numbers if number.over), "")
    if not over or not _visible(effect, problem):
        return effect if not over and _visible(effect, problem) else None
    low, *probes, high = np.quantile(_recorded(problem, over), (EDGE, *QUANTILES, 1.0 - EDGE)).tolist()
    if over == "speed":
        low, probes = max(low, SLOWEST), [one for one in probes if one > SLOWEST]
    return closure(law, problem.bench, (low, high), tuple(probes)) if high > low and probes else None


def tables(problem: Problem) -> list[Claim]:
    """Tables that these recordings can show, over what was recorded."""
    found = []
    for table in grammar.TABLES:
        if _visible(closure(table, problem.bench), problem):
            low, high = np.percentile(_over(problem, table), [INSIDE, 100.0 - INSIDE])
            if high > low:
                found += _nothing(closure(table, problem.bench, (float(low), float(high))))
    return found


_SIZES = {"speed": "velocity", "opening": "current"}


def _recorded(problem: Problem, name: str) -> FloatArray:
    """Recorded values of a signal that laws and tables run over."""
    values = np.concatenate([model.variable(_SIZES.get(name, name))[model.settle :] for model in problem.models])
    return np.abs(values) if name in _SIZES else values


def _over(problem: Problem, table: Table) -> FloatArray:
    """Recorded values of a table's variable."""
    if table.element is None:
        return _recorded(problem, table.where if table.variable == "force" else table.variable)
    driver = table.element.signal
    passed = []
    for model in problem.models:
        ones = np.ones_like(model.time)
        signal = ones if driver == "time" else np.abs(model.variable(_SIZES[driver]))
        passed.append(held_lag(signal, model.step, SETTLING, 0.0)[1][model.settle :])
    return np.concatenate(passed)


_CHANNELS = {
    "current": "valve_current",
    "position": "piston_position",
    "velocity": "piston_position",
    "acceleration": "piston_position",
}
"""Channels that signals are recorded in, if they are none themselves."""


def _visible(effect: Closure, problem: Problem) -> bool:
    have = set.intersection(*(set(model.channels) for model in problem.models))
    law, elsewhere = effect.law, {"", "edges", "across"}
    if (effect.places or effect.uses_acceleration) and len(effect.blocks & set(problem.blocks)) < 2:
        return False  # in one equation alone it cannot be told from a force
    if isinstance(law, Table) or law.uses:
        needed = {_CHANNELS.get(one, one) for one in law.uses} - {"time"}
        return bool(effect.blocks & set(problem.blocks)) and needed | ({law.where} - elsewhere) <= have
    pressures = {"pressure_a", "pressure_b"} if "p_" in law.text and law.where != "load_force" else set()
    return bool(effect.blocks & set(problem.blocks)) and pressures | ({law.where} - elsewhere) <= have


def _nothing(effect: Closure) -> list[Claim]:
    return [Claim(effect, values) for values in effect.nothing()]


def ways_beside(problem: Problem, base: Fit) -> list[Responses]:
    """Ways of each segment, under the claims of a fit."""
    return [Responses(model, problem.blocks, (*problem.baseline, *base.claims)) for model in problem.models]


def column_gains(own: FloatArray, cross: FloatArray, square: FloatArray, weight: FloatArray, count: FloatArray,
                 size: float) -> tuple[FloatArray, float]:  # fmt: skip
    """Held-out deviance gained by each term, and the deviance before, from products by fold and channel.

    The normal equations of the standing columns and one more are solved by its Schur complement.
    """
    many = square.shape[-1]
    before, after = np.zeros(len(weight)), np.zeros((len(weight), many))
    weighted = [np.einsum("fc...,c->f...", one, weight) for one in (own, cross, square)]
    together = [one.sum(axis=0) for one in weighted]
    for k in range(len(own)):
        a, b, d = (whole - one[k] for whole, one in zip(together, weighted, strict=True))
        inverse = np.linalg.pinv(a[1:, 1:], rcond=1e-10, hermitian=True) if len(a) > 1 else np.zeros((0, 0))
        alone = -inverse @ a[1:, 0]
        full = np.concatenate([[1.0], alone])
        before += np.einsum("i,cij,j->c", full, own[k], full)
        turned = inverse @ b[1:]
        rest = d - np.sum(b[1:] * turned, axis=0)
        left = b[0] + alone @ b[1:]
        amount = np.where(rest > 1e-9 * d, -left / np.maximum(rest, 1e-300), 0.0)
        theta = np.concatenate([np.ones((1, many)), alone[:, None] - turned * amount])
        after += np.einsum("im,cij,jm->cm", theta, own[k], theta)
        after += 2.0 * amount * np.einsum("im,cim->cm", theta, cross[k]) + amount**2 * square[k]

    def deviance(squares: FloatArray) -> FloatArray:
        places = (..., *(None for _ in range(squares.ndim - 1)))
        variance = np.maximum(squares / np.maximum(count, 1.0)[places], 1.0)
        return np.asarray(np.sum(count[places] * np.log(variance) + squares / variance, axis=0))

    reached = float(deviance(before * size))
    return reached - deviance(after * size), reached


ROWS = 40000
"""Residuals of a channel beyond which only every second, third ... is taken."""
CHUNK = 64
"""Terms whose responses are multiplied at a time."""
Chunk = tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]
"""Places of terms, and their responses, shape (terms, rows)."""


class FoldedResponses:
    """Responses of `terms` terms, added law by law.

    `every`: only every so many residuals are looked at. `count`: residuals of each channel that are, shape (channels,).
    `square`: of each term with itself, shape (folds, channels, terms).
    """

    def __init__(self, layout: Layout, terms: int) -> None:
        self.every = max(int(layout.count.max()) // ROWS, 1)
        fold = layout.folds()
        kept = [np.flatnonzero(layout.channel == k)[:: self.every] for k in range(len(CHANNELS))]
        self._order = [np.argsort(fold[rows], kind="stable") for rows in kept]
        self._rows = [rows[order] for rows, order in zip(kept, self._order, strict=True)]
        self._folds = [np.searchsorted(fold[rows], np.arange(FOLDS + 1)) for rows in self._rows]
        self.count = np.array([len(rows) for rows in self._rows], dtype=np.float64)
        self.square = np.zeros((FOLDS, len(CHANNELS), terms))
        self._chunks: dict[int, list[Chunk]] = {}
        self._waiting: dict[int, list[Chunk]] = {}

    def add(self, places: npt.NDArray[np.int64], shown: Mapping[int, FloatArray]) -> None:
        """Take the responses of a law's terms by channel, shape (terms, residuals of the channel)."""
        for channel, columns in shown.items():
            thinned = columns[:, :: self.every].astype(np.float32)[:, self._order[channel]]
            self._waiting.setdefault(channel, []).append((places, thinned))
            if sum(len(one) for one, _ in self._waiting[channel]) >= CHUNK:
                self._keep(channel, self._waiting.pop(channel))

    def finish(self) -> None:
        """Take what was added last."""
        for channel in list(self._waiting):
            self._keep(channel, self._waiting.pop(channel))

    def _keep(self, channel: int, chunks: Sequence[Chunk]) -> None:
        places, columns = (np.concatenate(one) for one in zip(*chunks, strict=True))
        self._chunks.setdefault(channel, []).append((places, columns))
        for k, (begin, end) in enumerate(pairwise(self._folds[channel])):
            part = columns[:, begin:end]
            self.square[k, channel, places] = np.einsum("ij,ij->i", part, part)

    def products(self, standing: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Products of standing columns, shape (residuals, columns), with each other and with the terms.

        Returns
        -------
        Shapes (folds, channels, columns, columns) and (folds, channels, columns, terms).
        """
        width = standing.shape[1]
        own = np.zeros((FOLDS, len(CHANNELS), width, width))
        cross = np.zeros((FOLDS, len(CHANNELS), width, self.square.shape[-1]))
        for channel, rows in enumerate(self._rows):
            looked_at = standing[rows]
            for k, (begin, end) in enumerate(pairwise(self._folds[channel])):
                part = looked_at[begin:end]
                own[k, channel] = part.T @ part
                single = part.astype(np.float32)
                for places, columns in self._chunks.get(channel, ()):
                    cross[k, channel][:, places] = (columns[:, begin:end] @ single).T
        return own, cross


CHANCE = 20.0
"""Deviance on held-out blocks that a single column must gain, as the search asks of a cause."""


def threshold(columns: int) -> float:
    """Deviance that the best of so many columns must gain: chance alone reaches 2 ln(columns)."""
    return CHANCE + 2.0 * float(np.log(max(columns, 1)))


@dataclass(frozen=True)
class Prospect:
    """A law that may join a fit."""

    gain: float
    """Held-out deviance that it gains, to first order."""
    starts: tuple[Claim, ...]
    """Values to fit it from, the best first."""

    @property
    def effect(self) -> Effect:
        """The law."""
        return self.starts[0].effect


class Screen:
    """All laws over the recordings of a problem.

    `problem`: the least-squares problem. `base`: names that stand. `terms`: laws at start values, those of a law one
    after the other; without amplitude.
    """

    def __init__(self, problem: Problem, base: Fit, terms: Sequence[Claim]) -> None:
        self.problem, self.terms = problem, list(terms)
        self._laws: list[slice] = []
        """Places of each law's terms."""
        self._responses = FoldedResponses(problem.layout, len(self.terms))
        ways = ways_beside(problem, base)
        at = 0
        for _, same in groupby(self.terms, key=lambda one: one.effect.label):
            probes = [_probed(one) for one in same]
            self._laws.append(slice(at, at + len(probes)))
            shown = problem.joined([way.of(probes) for way in ways], len(probes))
            self._responses.add(np.arange(at, at + len(probes)), shown)
            at += len(probes)
            problem.budget.spend(problem.samples * len(probes))
        self._responses.finish()

    def __len__(self) -> int:
        return len(self.terms)

    def prospects(self, found: Fit, count: int, without: Collection[str] = ()) -> tuple[list[Prospect], float]:
        """The laws that gain most beside a fit, their further numbers paid, and what there is to gain at all."""
        gains, there_is = self.gains(found)
        price = float(np.log(len(found.residual)))
        by_law = []
        for at in self._laws:
            effect = self.terms[at.start].effect
            if effect.label in without:
                continue
            order = at.start + np.argsort(-gains[at])
            paid = gains[order[0]] - price * (len(effect.parameters) - 1)
            by_law.append((paid, float(gains[order[0]]), [self.terms[k] for k in order]))
        by_law.sort(key=lambda one: -one[0])
        return [Prospect(gain, _apart(terms)) for _, gain, terms in by_law[:count]], there_is

    def gains(self, found: Fit) -> tuple[FloatArray, float]:
        """Held-out deviance that each term gains beside a fit, shape (terms,), and what there is to gain at all."""
        base = np.column_stack([found.residual, found.jacobian])
        lengths = np.maximum(np.linalg.norm(base, axis=0), SHORTEST)
        base = base / lengths
        responses = self._responses
        weight = 1.0 / self.problem.variances(found.residual)
        size = float(lengths[0]) ** 2
        products = responses.products(base)
        gains, before = column_gains(*products, responses.square, weight, responses.count, size)
        return gains * responses.every, (before - float(responses.count.sum())) * responses.every


def _probed(claim: Claim) -> Claim:
    sizes = {one.name: one.probes[0] for one in claim.effect.amplitudes}
    return Claim(claim.effect, {**claim.values, **sizes})


def _apart(terms: Sequence[Claim]) -> tuple[Claim, ...]:
    """The best start, and of a law with several further numbers the best with each other value of the first."""
    names = [one.name for one in terms[0].effect.shapes]
    if len(names) < 2:
        return tuple(terms[:1])
    found: dict[float, Claim] = {}
    for one in terms:
        found.setdefault(one.values[names[0]], one)
    return tuple(found.values())
