# SPDX-License-Identifier: Apache-2.0
"""Estimation of the parameters of hypotheses by weighted least squares: noise, problem, fit, screening, intervals."""
