# SPDX-License-Identifier: Apache-2.0
# The two commands: `make train` and `make test`. Every target but help and clean first sets up a fresh machine.

SHELL := /bin/bash
.DEFAULT_GOAL := help
# PYTHON=python3.12 chooses the interpreter of a first set-up; later the environment's own is taken.
PYTHON ?= $(shell [ -x .venv/bin/python ] && echo .venv/bin/python || echo python3)
# Further words for the command behind a target: make train ARGS="--episodes 12", make test ARGS="-k bag".
ARGS ?=
N ?= 100
SOURCED := source install/setup.bash &&
NONE_CHOSEN := 5
# Names of which the house has others: gains_timeout, export, export_c, ReportMarks, flag_labels, last_line ...
NONSTANDARD := abandoned_after|box_header|filter_header|Findings|flag_words|last_words|listen_to_box|PolicyKeeper|untold
# Three workers on two cores: what waits for a node to start leaves its core to another.
SHARED_OUT := -n 3 --dist loadgroup --no-loadscope-reorder
CORES := setup $(patsubst %/py.typed,%,$(wildcard src/hydro_*/hydro_*/py.typed))

# Graphs stay on this machine, and apart from a bench that runs on the default domain (tests: tests/domains.py).
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
bench: export ROS_DOMAIN_ID ?= 77
# Hundreds of processes start here: each would compile every module again.
unexport PYTHONDONTWRITEBYTECODE
# Tests and benchmarks have nodes of their own, which no keystore knows.
test test-slow graph-repeat fast-tests colcon-test bench fuzz-line soak: export ROS_SECURITY_ENABLE := false

.PHONY: help setup main-job-setup test-setup lint-setup build train prove test test-slow graph-repeat check lint fast-tests colcon-test demo
.PHONY: bench bench-peers paper fuzz-line soak firmware format docs coverage clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## environment, pinned wheels, built packages, compiled kernels; at once when nothing changed
	@$(PYTHON) -m setup.bootstrap

main-job-setup:
	@$(PYTHON) -m setup.bootstrap --main-job

test-setup:
	@$(PYTHON) -m setup.bootstrap --checks

lint-setup:
	@$(PYTHON) -m setup.bootstrap --checks --without-kernels

build: setup  ## the same: rebuilds and compiles after a change of messages, executables, launch files or kernels

train: main-job-setup  ## a short training on the emulated bench over the serial line, recorded and evaluated
	@$(SOURCED) ros2 run hydro_policy trainer --demo $(ARGS)

prove: setup  ## the diagnosis on 20 sealed cases (ARGS="--cases 224 --seed 20261124" repeats docs/reports/proof.md)
	@$(SOURCED) .venv/bin/python -m benchmarks.prove $(if $(ARGS),$(ARGS),--cases 20 --seed 1)

test: lint test-setup  ## all checks and all tests but the studies
	@$(SOURCED) .venv/bin/python -m pytest -m "not study" $(SHARED_OUT) $(ARGS) || [ $$? -eq $(NONE_CHOSEN) ]

test-slow: test-setup  ## before a release: the studies among the tests, and the tests of the benchmarks
	@$(SOURCED) .venv/bin/python -m pytest -m study $(SHARED_OUT) $(ARGS) || [ $$? -eq $(NONE_CHOSEN) ]

graph-repeat: test-setup  ## the graph tests N times beside a busy process, until one fails (N=100 ARGS="-k recorder")
	@$(SOURCED) { yes > /dev/null & trap "kill $$!" EXIT; for n in $$(seq $(N)); do echo "repetition $$n"; \
	  .venv/bin/python -m pytest -q -x -m graph $(ARGS) || exit 1; done; }

check: lint fast-tests  ## format, lint, types, import rules and the fast tests

lint: lint-setup
	@.venv/bin/ruff format --check .
	@.venv/bin/ruff check .
	@.venv/bin/mypy $(CORES) benchmarks demo
	@$(SOURCED) .venv/bin/lint-imports --no-logo
	@! git grep -nwE '$(NONSTANDARD)' -- 'src/*.py' 'benchmarks/*.py' 'tests/*.py' 'docs/*.py' 'demo/*.py'

fast-tests: test-setup
	@$(SOURCED) .venv/bin/python -m pytest -m "not slow and not graph and not study" $(ARGS)

colcon-test: test-setup  ## each package's tests by `colcon test`, as a ROS build farm runs them
	@$(SOURCED) .venv/bin/python -m colcon test --base-paths src firmware $(if $(ARGS),--pytest-args " $(ARGS)") \
	  && .venv/bin/python -m colcon test-result --verbose

demo: setup  ## a policy, a bench that its simulation did not know, the diagnosis, the policy retrained: minutes
	@$(SOURCED) .venv/bin/python -m demo $(ARGS)

bench: setup  ## the measured speeds of the filter's call and of the whole graph
	@$(SOURCED) .venv/bin/python -m benchmarks.filter_call && .venv/bin/python -m benchmarks.latency

bench-peers: test-setup  ## peers of the learner in an environment of their own (.venv-bench), and the comparison
	@[ -x .venv-bench/bin/python ] || $(PYTHON) -m venv .venv-bench
	@.venv/bin/python -c 'import site; print(site.getsitepackages()[0])' > $$(echo .venv-bench/lib/python3*/site-packages)/hydro.pth
	@.venv-bench/bin/python -m pip install -q -r requirements-bench.txt
	@$(SOURCED) .venv-bench/bin/python -m benchmarks.sac_peers $(ARGS)

paper: setup  ## the paper's method, row by row, beside its numbers: hours, goes on where it was (ARGS=--quick: minutes)
	@$(SOURCED) .venv/bin/python -m benchmarks.paper --report docs/reports/paper.md $(ARGS)

fuzz-line: setup  ## ten million hostile bytes each way of an armed plant's serial line
	@$(SOURCED) .venv/bin/python -m benchmarks.soak --causes "corrupt bytes" "corrupt bytes alone" --lasts 100 $(ARGS)

soak: setup  ## an hour of training under faults drawn at random (ARGS="--seed 1 --hours 0.1")
	@$(SOURCED) .venv/bin/python -m benchmarks.soak $(ARGS)

firmware:  ## the box in C: unit tests, 10^7 hostile bytes under sanitizers, coverage, mutants, operations (ARGS="--no-mutants")
	@$(PYTHON) firmware/test/checks.py $(ARGS)

docs: lint-setup  ## the manual as a site in site/, in an environment of its own (.venv-docs); every warning is an error
	@[ -x .venv-docs/bin/python ] || $(PYTHON) -m venv .venv-docs
	@.venv-docs/bin/python -m pip install -q -r requirements-docs.txt
	@.venv-docs/bin/mkdocs build --strict --quiet && echo "site/index.html"

coverage: test-setup  ## the fast tests with the share of lines that they reach, by package (ARGS="-k bag")
	@$(SOURCED) .venv/bin/python -m coverage run -m pytest -m "not slow and not graph and not study" $(ARGS)
	@.venv/bin/python -m coverage report

format: lint-setup  ## rewrite the sources in the house format
	@.venv/bin/ruff format . && .venv/bin/ruff check --fix .

clean:  ## remove what is built; the environment stays (`rm -r .venv` removes that too)
	rm -rf build install log .cache
