# SPDX-License-Identifier: Apache-2.0
"""Serial line to the box: frames and their bytes, the stream decoder, the port."""
