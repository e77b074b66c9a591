# SPDX-License-Identifier: Apache-2.0
"""Adaptive compensation of the reference: `estimator` fits the coefficients of the compensated law to the bench.

`live` does so on the samples of a running one. Knows no ROS.
"""
