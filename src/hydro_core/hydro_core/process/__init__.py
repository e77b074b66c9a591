# SPDX-License-Identifier: Apache-2.0
"""Utilities of all processes: start-up, termination by signals, real-time limits, latency statistics."""
