# SPDX-License-Identifier: Apache-2.0
"""What a corrected model is worth on recordings that no parameter has seen.

May import `estimation` and `model`.
"""
