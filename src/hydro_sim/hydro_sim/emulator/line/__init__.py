# SPDX-License-Identifier: Apache-2.0
"""The emulated serial line: pseudo-terminal, frames both ways, faults.

May import `hydro_bridge.serial`, and nothing of the emulator.
"""
