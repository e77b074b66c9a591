# SPDX-License-Identifier: Apache-2.0
"""The learner process: learner, shared memory, supervision.

May import `sac` and `runs`.
"""
