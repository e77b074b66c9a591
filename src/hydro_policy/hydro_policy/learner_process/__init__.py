# SPDX-License-Identifier: Apache-2.0
"""The process that learns beside acting: the learner, shared memory, its supervision.

May import `sac` and `runs`.
"""
