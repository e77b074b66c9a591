# SPDX-License-Identifier: Apache-2.0
"""ROS nodes: they move messages and hold no mathematics."""
