# SPDX-License-Identifier: Apache-2.0
"""References and gains over time that excite a bench: schedules, random ones, playback, coverage.

May import `hydro_bridge.signals` and `model`.
"""
