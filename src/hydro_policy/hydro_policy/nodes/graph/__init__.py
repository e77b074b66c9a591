# SPDX-License-Identifier: Apache-2.0
"""Session on the ROS graph: the node, the wait for the lease, messages to the user, progress.

Knows neither command lines nor the folders of runs.
"""
