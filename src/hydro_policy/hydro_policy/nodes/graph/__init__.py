# SPDX-License-Identifier: Apache-2.0
"""A session on the ROS graph: the node, the authority it waits for, its messages to people, its progress.

Knows neither command lines nor the folders of runs.
"""
