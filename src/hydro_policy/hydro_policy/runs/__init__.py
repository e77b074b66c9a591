# SPDX-License-Identifier: Apache-2.0
"""A run on disk: folder, settings, checkpoints, run.json, the initial agent."""
