# SPDX-License-Identifier: Apache-2.0
"""Conformance test of a box against protocol.md: one pytest function a rule, in `at_rest` and in `moving`."""
