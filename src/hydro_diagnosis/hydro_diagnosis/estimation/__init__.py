# SPDX-License-Identifier: Apache-2.0
"""Parameters of hypotheses by weighted least squares: the problem, the fit, score tests, intervals, free-form inputs.

May import `model`, `effects` and what stands below them.
"""
