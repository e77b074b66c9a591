# SPDX-License-Identifier: Apache-2.0
"""Verbs of `ros2` for a ROS 2 from wheels: `topic`, `node`, `service`, `bag info` and `launch`.

Arguments and output follow upstream's; ros2_verbs.md lists the differences. All other verbs need a full ROS 2.
`setup/ros2.py` calls `command`; where a full ROS 2 is sourced, its own `ros2` is used instead.
"""
