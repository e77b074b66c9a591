# SPDX-License-Identifier: Apache-2.0
# The two commands: `make train` and `make test`. Both set up a fresh machine first.

SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON ?= $(shell [ -x .venv/bin/python ] && echo .venv/bin/python || echo python3)
# Every recipe that runs the packages starts with this.
SOURCED = source install/setup.bash
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: help setup build train test check fast-tests bench fuzz colcon-test format clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## environment, pinned wheels, built packages; quick when nothing changed (PYTHON=python3.12 chooses the interpreter)
	@$(PYTHON) -m setup.bootstrap

build: setup  ## the same: rebuilds after a change of messages, executables, launch or config files

train: setup  ## train on whichever plant publishes; without one, on the simulation
	@$(SOURCED) && ros2 run hydro_policy trainer --demo

format: setup  ## rewrite the sources in the house format
	@.venv/bin/ruff format . && .venv/bin/ruff check --fix .

clean:  ## remove what is built; the environment stays (`rm -r .venv` removes that too)
	rm -rf build install log .cache/setup
