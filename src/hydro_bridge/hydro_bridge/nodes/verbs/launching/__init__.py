# SPDX-License-Identifier: Apache-2.0
"""Subset of `ros2 launch` that covers this repository's launch files.

`description` implements upstream's classes for such files; `modules` makes them importable under upstream's names;
`processes` starts and stops the described processes; `verb` is the command.
"""
