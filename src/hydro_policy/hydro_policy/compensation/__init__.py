# SPDX-License-Identifier: Apache-2.0
"""Adaptive compensation of the reference: `estimator` fits the coefficients of the compensated law to the bench.

`live` runs it on the samples of a running bench; `residual` adds a learned correction. Independent of ROS.
"""
