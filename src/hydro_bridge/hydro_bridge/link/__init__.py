# SPDX-License-Identifier: Apache-2.0
"""The bridge's end of the serial line: its state machine, how long things take on it, the box's clock.

May import `serial` and `safety`; knows no ROS.
"""
