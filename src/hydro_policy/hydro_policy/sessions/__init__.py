# SPDX-License-Identifier: Apache-2.0
"""Sessions, which control a plant step by step, without ROS: training, episodes, exploration, state of a run.

May import all of this package but `pretraining` and `nodes`.
"""
