# SPDX-License-Identifier: Apache-2.0
"""How much evidence chance reaches: null simulations, and the threshold that a claim must pass.

May import the stages before it, up to `experiment_design`.
"""
