# SPDX-License-Identifier: Apache-2.0
"""Simulation of box and plant: offline, in real time, in lock-step.

May import `model` and `box`.
"""
