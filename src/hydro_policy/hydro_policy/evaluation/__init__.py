# SPDX-License-Identifier: Apache-2.0
"""Comparison of controllers on a live plant: runs, policy examinations, search of the best fixed gains, report.

May import `task`, `sac`, `supervision` and `runs`.
"""
