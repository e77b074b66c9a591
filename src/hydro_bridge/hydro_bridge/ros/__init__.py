# SPDX-License-Identifier: Apache-2.0
"""Utilities of all nodes: topics, message conversion, parameters, diagnostics, spinning, companion processes."""
