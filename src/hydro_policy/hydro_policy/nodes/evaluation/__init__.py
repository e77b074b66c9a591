# SPDX-License-Identifier: Apache-2.0
"""An evaluation on a live plant: the run and its results.

May import `startup` and `graph`.
"""
