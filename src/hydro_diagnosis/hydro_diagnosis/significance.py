# SPDX-License-Identifier: Apache-2.0
"""Significance levels and thresholds of every decision: chance, evidence, practical relevance."""

from __future__ import annotations

from scipy.special import ndtri

CONFIDENCE = 0.975
"""Confidence level of each side of a two-sided 95 % interval."""
QUANTILE = float(ndtri(CONFIDENCE))
"""Half-width of a 95 % interval in standard deviations of a Gaussian."""
COVERAGE_FACTOR = 2.0
"""Standard uncertainties from which a value is significant (coverage factor k): `QUANTILE`, rounded up."""
OUTLIER_FACTOR = 3.0
"""Standard deviations beyond which a single value is an outlier (Huber 1964): noise exceeds them once in 400 values."""
VERY_STRONG_EVIDENCE = 10.0
"""Difference of two BICs, or of two deviances, that is very strong evidence (Kass and Raftery 1995, section 3.2)."""
CLAIM_THRESHOLD = 2.0 * VERY_STRONG_EVIDENCE
"""Evidence [BIC, deviance] that a claim needs beyond its parameters' price: a choice, checked on recordings with
nothing missing (`benchmarks.null_simulations`)."""
PRACTICAL_SHARE = 0.05
"""Share of what a force varies by, or of any other size, that is of practical relevance."""
TIE_RATIO = 0.8
"""Ratio of the gains, or residuals, of two explanations from which they tie: the simpler or more usual one is taken."""
UNIDENTIFIED_HALF_WIDTH = 0.5
"""Half-width of a 95 % interval, over the value or its range, from which a parameter is not identified."""
FOLDS = 4
"""Number of folds of every cross-validation."""
FOLD_TIME = 1.0
"""Length of a held-out block [s]: many times the correlation time of any residual."""
EXCESS_THRESHOLD = 0.35
"""Excess over 1 of a channel's mean square over the noise variance that is more than noise: the latter's uncertainty.
"""
ITERATIONS = 8
"""Largest number of rounds of any iteration; most converge, by their gain, after three."""
