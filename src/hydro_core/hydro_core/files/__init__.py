# SPDX-License-Identifier: Apache-2.0
"""Files: atomic output, digests of bench files, the files of a site, validation of tensors."""
