# SPDX-License-Identifier: Apache-2.0
"""From paths to what is fitted and what is held out: loading, streaming of long recordings, their informative windows.

May import `io`, `preprocessing` and `wiring`.
"""
