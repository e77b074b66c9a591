# SPDX-License-Identifier: Apache-2.0
"""A learned model of any structure: its file, the plant that steps it, the region that it was trained in.

May import `structured`, `neural` and `files`.
"""
