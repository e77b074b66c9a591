# SPDX-License-Identifier: Apache-2.0
"""Common base of all packages: signals, settings, files, console, errors, processes.

`signals` defines the exchanged quantities, `settings` the configuration; `files` has validated input and atomic output,
`cli` the console interface, `process` start-up and termination. It depends neither on ROS nor on a bench or a serial
line.
"""
