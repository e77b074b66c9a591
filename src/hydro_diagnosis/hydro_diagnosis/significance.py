# SPDX-License-Identifier: Apache-2.0
"""Levels by which everything is decided: what chance makes, which evidence decides, what matters to a person."""

from __future__ import annotations

from scipy.special import ndtri

CONFIDENCE = 0.975
"""Of each side of an interval: 95 % in all."""
QUANTILE = float(ndtri(CONFIDENCE))
"""Standard deviations of a Gaussian within which it lies."""
SURE = 2.0
"""Multiple of a doubt beyond which a value is no doubt's: `QUANTILE`, rounded up."""
OUTLYING = 3.0
"""Standard deviations beyond which a single value is no noise (Huber 1964): one of 400 is."""
DECISIVE = 10.0
"""Difference of two BICs, or of two deviances, that is very strong evidence (Kass and Raftery 1995, section 3.2)."""
CLAIMED = 2.0 * DECISIVE
"""Evidence [BIC, deviance] that a claim needs beyond its parameters' price: a choice, held against recordings with
nothing missing (`benchmarks.null_simulations`).
"""
MATTERS = 0.05
"""Share of the largest force, or of any other size, that matters to a person."""
MINOR = 0.1
"""Share of what remains below which something says little about it: twice what matters."""
ALIKE = 0.8
"""Ratio of what two explanations gain, or leave, from which they are as good: then the simpler or more usual stands."""
VAGUE = 0.5
"""Half-width of a 95 % interval, over the value or its range, from which a number is not identified."""
FOLDS = 4
"""Folds of every cross-validation."""
ITERATIONS = 8
"""Rounds of any iteration at most; each ends by what it gains, most after three."""
