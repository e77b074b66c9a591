# SPDX-License-Identifier: Apache-2.0
"""Commissioning of a bench: the gates in their order, the executables that they run, and the record of the site.

The packages below and beside this one are run as processes, and their JSON is read: nothing of them is imported.
"""
