# SPDX-License-Identifier: Apache-2.0
"""Data sets: loading, fitted and held-out parts, streaming of long recordings, informative windows.

May import `io`, `preprocessing` and `wiring`.
"""
