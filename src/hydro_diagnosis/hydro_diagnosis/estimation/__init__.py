# SPDX-License-Identifier: Apache-2.0
"""Parameters of hypotheses by weighted least squares: problem, fit, score tests, intervals, free-form inputs."""
