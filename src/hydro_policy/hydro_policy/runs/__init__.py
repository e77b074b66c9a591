# SPDX-License-Identifier: Apache-2.0
"""A run on disk: folder, settings, checkpoints, run.json, the agent to start from.

May import `task`, `sac` and the settings of `supervision`.
"""
