# SPDX-License-Identifier: Apache-2.0
"""The filter, from one sample to one correction: its factory, compiled form, model monitor and statistics.

May import `model`, `metric` and `certificate`; nodes, vectorised benches and validation run it.
"""
