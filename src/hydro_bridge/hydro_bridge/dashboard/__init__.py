# SPDX-License-Identifier: Apache-2.0
"""Live page of a running graph, without ROS: downsampled series, status texts, command rules, a local web server."""
