# SPDX-License-Identifier: Apache-2.0
"""A second truth plant, written from the specification by somebody who had seen neither the emulator nor the diagnosis.

The proof's plant and the engine share authors, integrator and habits; an error in both would go unseen. This one shares
the equations on paper and the numbers of bench.yaml, and imports nothing of hydro_sim and hydro_diagnosis. The
diagnosis runs as its command, in a process of its own, on recordings as any bench would leave them.

    bench.yaml -> bench -> equations -> plant -> benchmarks.beyond_the_table, benchmarks.logging_rates
"""
