# SPDX-License-Identifier: Apache-2.0
"""The task: Markov decision process, 10 ms steps from 1 ms samples, evaluation cases, scores."""
