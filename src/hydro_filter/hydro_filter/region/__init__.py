# SPDX-License-Identifier: Apache-2.0
"""Certified region: a metric proved to contract over a box of states, gains and benches."""
