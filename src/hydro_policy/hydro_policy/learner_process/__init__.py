# SPDX-License-Identifier: Apache-2.0
"""The learner process: learner, shared memory, supervision."""
