# SPDX-License-Identifier: Apache-2.0
"""Certified regions: states, gains and benches over which the force loop is proved to contract.

parameters  of the bench file and of the force law's bench; states of a region
metric      the metric of a region, by semidefinite programming (Clarabel, requirements-bench.txt)
statement   a statement for a bench file and a law; paper.json and compensated.json are those of the shipped bench
__main__    makes one; `benchmarks.verify_region` proves it from its file alone, by numpy
"""
