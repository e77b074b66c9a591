# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic: the algorithm, its compiled updates, networks, replay buffer, snapshots, the acting policy."""
