# SPDX-License-Identifier: Apache-2.0
"""Evaluation on a live plant: the run and its results.

May import `startup` and `graph`.
"""
