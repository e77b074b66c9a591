# SPDX-License-Identifier: Apache-2.0
"""Who may do what in the graph, and the keys that make it so: rights, SROS2 policy, keystore, this process' enclave."""
