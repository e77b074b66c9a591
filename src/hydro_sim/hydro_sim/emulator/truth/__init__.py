# SPDX-License-Identifier: Apache-2.0
"""Truth plant, deliberately independent of `hydro_sim.model`: oil by content, valve edges, friction, load, sensing.

Only the emulator and the filter's validation may import it.
"""
