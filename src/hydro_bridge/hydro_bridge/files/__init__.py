# SPDX-License-Identifier: Apache-2.0
"""Files that are checked as they are read and whole when they are written: bench.yaml, tensors, atomic replacement.

May import `errors` and `signals`; everything may import it.
"""
