# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Every target is complete in itself: on a fresh machine it installs and builds what it needs first.

SHELL := /bin/bash
ROS_PYTHON := /usr/bin/python3
IN_WORKSPACE := bash tools/in-workspace.sh

.DEFAULT_GOAL := help
.PHONY: help deps build venv demo gui test test-long benchmark performance screenshots docs clean

help: ## what there is to make
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 22

deps: ## install the distribution's packages that are missing
	@bash tools/deps.sh

build: deps ## build the checkout in a catkin workspace of its own, build/ws
	@bash tools/build.sh

demo: build ## run the demonstration on the soccer field (options: make demo ARGS="...")
	@$(IN_WORKSPACE) $(ROS_PYTHON) -m dyknow_demo $(ARGS)

gui: build ## open the window on the computation graph
	@$(IN_WORKSPACE) rosrun dyknow dyknow_rqt $(ARGS)

test: deps ## run the checks and the tests that are quick (ROSTEST_JOBS=1 runs the rostest suites one by one)
	@$(ROS_PYTHON) tools/check.py

test-long: deps ## run what takes long: many random steps, repeated faults, measurements, Python 3.8, coverage
	@$(ROS_PYTHON) tools/check.py --long

benchmark: build ## measure the time to arrival over a chain of nodelets (options: make benchmark ARGS="...")
	@$(IN_WORKSPACE) rosrun dyknow benchmark $(ARGS)

performance: build venv ## measure everything that doc/performance.md shows, and write it there (most of an hour; ARGS="chain" for one)
	@$(IN_WORKSPACE) $(ROS_PYTHON) tools/performance.py $(ARGS)

screenshots: build ## take the pictures of the documentation again
	@QT_QPA_PLATFORM=offscreen $(IN_WORKSPACE) $(ROS_PYTHON) -m dyknow_rqt.screenshots doc/images
	@DYKNOW_PICTURES="$(CURDIR)/doc/images" $(IN_WORKSPACE) rostest --text test/ros/rqt_window.test

docs: deps ## build the documentation, build/docs/index.html
	@$(ROS_PYTHON) -m sphinx -q -W --keep-going -b html doc build/docs
	@echo "docs: build/docs/index.html"

venv: deps ## make the virtual environment of the checks, build/venv
	@bash tools/venv.sh venv $(ROS_PYTHON) tools/requirements-dev.txt --system-site-packages

clean: ## remove everything that was built
	rm -rf build
