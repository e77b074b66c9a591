# SPDX-License-Identifier: Apache-2.0
"""Force-tracking task: Markov decision process with 10 ms steps of 1 ms samples, evaluation cases, scores."""
