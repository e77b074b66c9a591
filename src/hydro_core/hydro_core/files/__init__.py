# SPDX-License-Identifier: Apache-2.0
"""Files with validated input and atomic output: bench.yaml, settings, tensors."""
