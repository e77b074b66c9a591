# SPDX-License-Identifier: Apache-2.0
"""The truth plant, independent of `hydro_sim.model` on purpose: oil by content, valve edges, friction, load, sensing.

Only the emulator and the filter's validation may import it.
"""
