# SPDX-License-Identifier: Apache-2.0
"""The filter: one sample in, one correction out; its factory, compiled forms, model monitor and statistics.

May import `model`, `metric` and `certificate`; nodes, vectorised benches and validation run it.
"""
