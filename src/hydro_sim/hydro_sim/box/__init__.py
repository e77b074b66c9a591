# SPDX-License-Identifier: Apache-2.0
"""What runs in the MicroLabBox each millisecond: reference, force law, arming, watchdog, limits.

May import `model`; simulation, emulator and vectorised benches run it.
"""
