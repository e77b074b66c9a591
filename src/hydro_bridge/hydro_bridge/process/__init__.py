# SPDX-License-Identifier: Apache-2.0
"""What every process of ours has in common: its start, its end by a signal, real-time limits, latencies.

May import nothing of hydro but `errors`; every executable may import it.
"""
