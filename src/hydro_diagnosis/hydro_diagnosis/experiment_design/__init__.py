# SPDX-License-Identifier: Apache-2.0
"""Experiment design: what to record next to distinguish hypotheses that the recordings do not separate.

May import the stages before it, up to `selection`.
"""
