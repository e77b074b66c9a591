# SPDX-License-Identifier: Apache-2.0
"""Preprocessing of recordings: quality checks, frozen sensors, time stamps, noise, smoothing.

May import `io`.
"""
