# SPDX-License-Identifier: Apache-2.0
"""The serial line with a stranger on it, who can be told what to do."""
