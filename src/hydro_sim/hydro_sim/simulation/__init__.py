# SPDX-License-Identifier: Apache-2.0
"""Box and plant put together: offline, in real time, in lock-step.

May import `model` and `box`.
"""
