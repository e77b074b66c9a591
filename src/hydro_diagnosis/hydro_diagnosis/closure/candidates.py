# SPDX-License-Identifier: Apache-2.0
"""Candidates of a closure: the grammar's laws and tables over what was recorded, and what each gains beside a fit."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from hydro_diagnosis.closure.evidence import Blocks, HeldOutBlocks
from hydro_diagnosis.closure.responses import Responses, shown
from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.effects.kernels import held_lag
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.law_signals import SIGN_VELOCITY
from hydro_sim.model.laws import Law
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


class Candidates:
    """Tables that may join a fit, and what each does to the residual there, to first order."""

    def __init__(self, problem: Problem, base: Fit, terms: Sequence[Claim]) -> None:
        self.terms = list(terms)
        ways = [Responses(problem, model, (*problem.baseline, *base.claims)) for model in problem.models]
        self._blocks = Blocks(problem)
        self._columns = [self._blocks.sorted(_columns(problem, base, ways, one)) for one in terms]
        self._own = [self._blocks.products(one, one) for one in self._columns]

    def without(self, label: str) -> Candidates:
        """All but the terms of one law."""
        kept, left = copy(self), [k for k, one in enumerate(self.terms) if one.effect.label != label]
        kept.terms = [self.terms[k] for k in left]
        kept._columns, kept._own = [self._columns[k] for k in left], [self._own[k] for k in left]
        return kept

    def gains(self, problem: Problem, base: Fit) -> tuple[FloatArray, float]:
        """Held-out deviance that each term gains, and that which there is to gain."""
        standing = self._blocks.sorted(np.column_stack([base.residual, base.jacobian]))
        squares, after = self._blocks.products(standing, standing), []
        for columns, own in zip(self._columns, self._own, strict=True):
            beside = self._blocks.products(standing, columns)
            products = [[squares, beside], [beside.swapaxes(-1, -2), own]]
            after.append(HeldOutBlocks.of_products(problem, base, products).deviance((0,)))
        before = HeldOutBlocks.of_products(problem, base, [[squares]]).deviance(())
        there_is = before - float(np.sum(problem.layout.count()))  # a residual that is noise alone leaves one each
        return before - np.array(after), there_is


def _columns(problem: Problem, base: Fit, ways: Sequence[Responses], claim: Claim) -> FloatArray:
    """Responses of the residual to a claim's amplitudes at neutral, in spans; shape (n, amplitudes)."""
    probes = [Claim(claim.effect, {**claim.values, one.name: one.span}) for one in claim.effect.parameters
              if one.smallest > 0.0]  # fmt: skip
    columns = np.zeros((len(problem.layout.channel), len(probes)))
    for channel, responses in shown(problem, base.claims, base.residual, ways, probes).items():
        columns[problem.layout.channel == channel] = responses.T
    return columns
