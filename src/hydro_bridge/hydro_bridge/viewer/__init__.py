# SPDX-License-Identifier: Apache-2.0
"""Page of a recording with a time slider, without ROS: downsampled series, marks, one self-contained HTML file."""
