# SPDX-License-Identifier: Apache-2.0
"""Training without ROS: the plan of its trials, and the state of a run.

May import all of this package but `pretraining` and `nodes`.
"""
