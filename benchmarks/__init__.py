# SPDX-License-Identifier: Apache-2.0
"""Measured speeds: each module measures one thing and runs alone (`python -m benchmarks.NAME [--json FILE]`)."""

import os

if _doubt := os.environ.get("HYDRO_WITHOUT_DOUBT"):  # of every process that `benchmarks.doubts` starts
    from benchmarks.doubts import leave_out

    leave_out(_doubt)
