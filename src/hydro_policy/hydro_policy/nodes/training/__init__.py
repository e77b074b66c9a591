# SPDX-License-Identifier: Apache-2.0
"""Training run on a live plant: preparation, the run, its results.

May import `evaluation`, `startup` and `graph`.
"""
