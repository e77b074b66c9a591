# SPDX-License-Identifier: Apache-2.0
"""Interfaces of the bench: serial line, recordings, and the guarded path of commands to the valve.

Layers: `serial` (frames), `safety` (command guard), `bags` (recordings), `link` (host side of the serial line), `pages`
(in a browser), `ros` (shared by all nodes), `nodes` (executables).
"""
