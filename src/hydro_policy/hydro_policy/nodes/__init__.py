# SPDX-License-Identifier: Apache-2.0
"""Executables and ROS nodes: message passing and process management, without mathematics."""
