# SPDX-License-Identifier: Apache-2.0
"""Pretraining by Soft Actor-Critic on simulated benches: configurations, the run, its examinations, the command."""
