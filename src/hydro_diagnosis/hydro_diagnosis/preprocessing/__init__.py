# SPDX-License-Identifier: Apache-2.0
"""Tables as data sets for fit and hold-out: quality checks, time stamps, noise, smoothing, informative windows."""
