# SPDX-License-Identifier: Apache-2.0
"""Verbs of `ros2` for where ROS 2 comes from wheels: `topic`, `node`, `param`, `service`, `bag info` and `launch`.

What they take and print follows upstream's; what differs is in the manual (ros2_verbs.md). Anything else needs a full
ROS 2. `setup/ros2.py` calls `command`; where a full ROS 2 is sourced its own `ros2` is, and nothing of this runs.
"""
