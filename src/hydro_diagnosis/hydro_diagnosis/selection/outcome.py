# SPDX-License-Identifier: Apache-2.0
"""Settings and outcome of a search."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from hydro_bridge.settings import quantity
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Effort of a search, and its thresholds of a claim."""

    threshold: Annotated[float, quantity("-", 0.0, 1000.0)] = 20.0
    """Evidence in units of BIC that a claim needs beyond its parameters' price: a choice, held against recordings
    with nothing missing (`benchmarks.null_simulations`).
    """
    most: Annotated[int, quantity("-", 0, 100)] = 6
    """Claims at most."""
    patience: Annotated[int, quantity("-", 1, 100)] = 100
    """Claims one after the other that may remove less than `MINOR` of what remains where they act: more is mimicry."""
    restarts: Annotated[int, quantity("-", 1, 10)] = 3
    """First claims that are tried, one search each, as long as something remains unexplained."""
    effort: Annotated[int, quantity("-", 100, 1000000)] = 9000
    """Evaluations of all residuals after which no further claim is looked for, and a third of which may go before
    the search begins again: some 3 ms each for 60 s of data.
    """


NAMES = SearchSettings(most=12, patience=2)
"""Settings of a search among names alone, which ends by itself where nothing remains or nothing has a name."""
MINOR = 0.1
"""Share of what remains in a channel below which a claim says little about it."""
CLOSE = 10.0
"""BIC within which a rival is not distinguished from a claim (Kass and Raftery 1995: decisive beyond it)."""


@dataclass(frozen=True)
class Step:
    """One step of the search, for the plot of how evidence converged."""

    action: str
    label: str
    score: float


@dataclass
class Outcome:
    """Outcome of a search."""

    problem: Problem
    """The problem with the weights of the fit."""
    fit: Fit
    nothing: Fit
    steps: list[Step] = field(default_factory=list)
    rivals: dict[str, list[Fit]] = field(default_factory=dict)
    """By a claim's label: fits in which another cause stands in its place, best first."""
    cut_short: str = ""
    """Why the search ended before nothing paid, in words; empty if it did not."""
