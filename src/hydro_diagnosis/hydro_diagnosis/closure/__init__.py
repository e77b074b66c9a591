# SPDX-License-Identifier: Apache-2.0
"""Closures: unnamed terms for the unexplained residual, selected by held-out evidence and admitted by simulation."""
