# SPDX-License-Identifier: Apache-2.0
"""The software of the MicroLabBox, one step each millisecond: reference, force law, arming, watchdog, limits.

May import `model`; simulation, emulator and vectorised benches run it.
"""
