# SPDX-License-Identifier: Apache-2.0
"""A training run on a live plant: preparation, the run, its results.

May import `evaluation`, `startup` and `graph`.
"""
