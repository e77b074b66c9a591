# SPDX-License-Identifier: Apache-2.0
"""Excitation of a bench by references and gains over time: schedules, random draws, playback, coverage.

May import `hydro_bridge.signals` and `model`.
"""
