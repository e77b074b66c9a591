# SPDX-License-Identifier: Apache-2.0
"""The filter, from one sample to one correction: its factory, its object around the C, its export to a box.

May import `model`, `metric` and `certificate`; nodes, vectorised benches and validation run it.
"""
