# SPDX-License-Identifier: Apache-2.0
"""The paper's own method, run on the emulated bench and printed beside the paper's numbers and beside ours.

=========== ==========================================================================
models      Table rmse_model: the paper's network and analytic model
metric      Table training_metric: a network M(x) for v along f_l, on the network model, and its filter at 100 Hz
validation  Table val_cont: gamma_1 to gamma_5
agents      Tables training_agent and rmse: controllers I, II, III
report      the page, and what the paper says, as comparisons
=========== ==========================================================================
"""
