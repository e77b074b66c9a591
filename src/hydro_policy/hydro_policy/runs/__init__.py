# SPDX-License-Identifier: Apache-2.0
"""A run on disk: folder, settings, checkpoints, run.json, the initial agent.

May import `task`, `sac` and the settings of `supervision`.
"""
