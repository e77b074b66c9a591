# SPDX-License-Identifier: Apache-2.0
"""The task: Markov decision process, steps of 10 ms out of samples of 1 ms, cases to be tried, their scores.

May import nothing else of this package.
"""
