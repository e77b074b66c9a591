# SPDX-License-Identifier: Apache-2.0
"""Thin ROS nodes and their command lines: they move messages, the mathematics is in the package above."""
