# SPDX-License-Identifier: Apache-2.0
"""The live page without ROS: thinned series, words, command rules, a local web server."""
