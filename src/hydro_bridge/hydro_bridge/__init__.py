# SPDX-License-Identifier: Apache-2.0
"""Interfaces of the bench: serial line, recordings, terminal, and the guarded path of commands to the valve.

`signals` defines the exchanged signals. Stages: `serial` (bytes), `safety` (command guard), `link` (host side of the
serial line), `bags` (recordings), `ros` (shared by all nodes), `nodes` (executables). Utilities: `files`, `cli`,
`process`.
"""
