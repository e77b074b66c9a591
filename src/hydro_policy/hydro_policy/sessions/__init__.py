# SPDX-License-Identifier: Apache-2.0
"""What drives a plant step by step without knowing ROS: training sessions, episodes, exploration, state of a run.

May import all of this package but `pretraining` and `nodes`.
"""
