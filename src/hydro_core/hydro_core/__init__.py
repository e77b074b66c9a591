# SPDX-License-Identifier: Apache-2.0
"""The ground of all packages: signals, settings, files, console, errors, processes, clocks.

`signals` names what is exchanged, `settings` what is chosen; `files` reads and writes whole files, `cli` talks to the
user, `process` begins and ends, `clock` maps the times of two machines. Knows no ROS, no bench and no serial line.
"""
