# SPDX-License-Identifier: Apache-2.0
"""Interfaces of the bench: serial line, recordings, and the guarded path of commands to the valve.

Layers: `serial` (frames), `safety` (command guard), `link` (host side of the serial line), `bags` (recordings), `ros`
(shared by all nodes), `nodes` (executables).
"""
