# SPDX-License-Identifier: Apache-2.0
"""The filter, from one sample to one correction: its factory, its wrapper of the C code, its export to a box.

May import `model` and `metric`; nodes and vectorised benches run it.
"""
