# SPDX-License-Identifier: Apache-2.0
"""Measured speeds: each module measures one thing and runs alone (`python -m benchmarks.NAME [--json FILE]`)."""
