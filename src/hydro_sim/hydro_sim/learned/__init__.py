# SPDX-License-Identifier: Apache-2.0
"""The bench as learned from recordings: x' = f(x, u), rolled out recursively (paper, section Hydraulic Model Learning)."""
