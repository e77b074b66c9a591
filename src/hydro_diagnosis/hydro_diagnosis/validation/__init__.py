# SPDX-License-Identifier: Apache-2.0
"""Accuracy of a corrected model on held-out recordings.

May import `estimation` and `model`.
"""
