# SPDX-License-Identifier: Apache-2.0
"""A recording as a page with a time slider, without ROS: thinned series, marks, one self-contained HTML file."""
