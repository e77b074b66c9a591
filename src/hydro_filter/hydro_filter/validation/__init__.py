# SPDX-License-Identifier: Apache-2.0
"""Table val_cont: cases, benches, runs and plots, with and without the filter.

The one place outside of the emulator that imports the truth plant, which it runs as the bench.
"""
