# SPDX-License-Identifier: Apache-2.0
"""What of a recording can be used: quality checks, stopped sensors, time stamps, noise, smoothing.

May import `io`.
"""
