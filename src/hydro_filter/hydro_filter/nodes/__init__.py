# SPDX-License-Identifier: Apache-2.0
"""ROS nodes, which transport messages and contain no mathematics."""
