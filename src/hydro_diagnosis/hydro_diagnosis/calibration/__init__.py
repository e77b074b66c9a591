# SPDX-License-Identifier: Apache-2.0
"""Calibration of the evidence threshold by null simulations.

May import the stages before it, up to `experiment_design`.
"""
