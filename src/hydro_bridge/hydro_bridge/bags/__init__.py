# SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2 folders and single .mcap files, read, written, checked, repaired and replayed, without ROS."""
