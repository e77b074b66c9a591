# SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2 folders and single .mcap files, read, written, checked, repaired and replayed, without ROS."""

from hydro_core.errors import UserError


class RecordingError(UserError):
    """A recording cannot be read or written; the message is one sentence."""
