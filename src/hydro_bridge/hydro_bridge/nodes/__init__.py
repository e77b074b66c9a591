# SPDX-License-Identifier: Apache-2.0
"""Executables: `bridge`, `recorder`, `replayer`. They move messages; what is computed stands in the modules above."""
