# SPDX-License-Identifier: Apache-2.0
"""Controllers compared on a live plant: runs, policy examinations, the best fixed gains, the report.

May import `task`, `sac`, `supervision` and `runs`.
"""
