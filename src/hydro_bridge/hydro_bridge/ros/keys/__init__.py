# SPDX-License-Identifier: Apache-2.0
"""Security by SROS2: rights of each executable, policy, keystore, enclave of this process."""
