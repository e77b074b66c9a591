# SPDX-License-Identifier: Apache-2.0
"""Executables and thin ROS nodes: they move messages and hold no mathematics."""
