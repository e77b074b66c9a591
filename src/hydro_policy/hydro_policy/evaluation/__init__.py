# SPDX-License-Identifier: Apache-2.0
"""Trials on a live plant and their runner; comparison, exploration, search of the best fixed gains, report."""
