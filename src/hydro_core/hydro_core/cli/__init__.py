# SPDX-License-Identifier: Apache-2.0
"""Utilities of all commands: console output, options on --resume, parallel jobs, launch arguments."""
