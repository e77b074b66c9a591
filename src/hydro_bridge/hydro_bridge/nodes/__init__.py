# SPDX-License-Identifier: Apache-2.0
"""Executables: `bridge`, `recorder`, `replayer` and others. They move messages and hold no mathematics."""
