# SPDX-License-Identifier: Apache-2.0
"""Live page of a running graph, without ROS: thinned series, status texts, command rules, a local web server."""
