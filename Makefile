# Every target does its own set-up: a machine with Python 3.11 or 3.12 and its venv module is enough.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
export PYTHON

# What a shell that has sourced a ROS installation leaves behind would mix with the ROS wheels of the environment.
unexport PYTHONPATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp
# Nothing that is started here talks to other machines; rclpy.init fails without a HOME.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export HOME := $(or $(HOME),$(CURDIR)/out/home)
export ROS_LOG_DIR := $(CURDIR)/out/ros_log
# Hundreds of processes import the package: each would compile it anew if none could keep what it compiled.
unexport PYTHONDONTWRITEBYTECODE
# One thread per process: the work is small matrices, and several processes share the cores.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: own-car exports studio-test help venv check test exam lint docs format house demo bench bench-against best thesis genesis road truth faults \
	leung blind recordings bags hw-tools hw hw-timing arm accelerator vehicle fuzz release clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: ## the virtual environment that the other targets use
	@mkdir -p out "$(HOME)"
	@.ci/venv $(VENV) "$(PYTHON)" $(addprefix -r requirements/,all.txt ros.txt test.txt dev.txt)

test: venv ## before a change lands: lint, types, contracts, tests, colcon build, and a part again with numpy 1.26
	@mkdir -p out && .ci/test

# EXAM="tests blind" takes some of its parts.
EXAM ?=
exam: venv ## hours, for the night: the tests that are too long for make test, all with numpy 1.26, and examinations
	@mkdir -p out && .ci/exam $(EXAM)

check: venv ## within a minute: lint, types, contracts, and the fast tests of what changed since main
	@.ci/check

lint: venv ## ruff, mypy, and the contracts about which package may import which
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

format: venv ## let ruff mend what it can
	$(VENV)/bin/ruff check --fix-only .
	$(VENV)/bin/ruff format .

house: venv ## the measures of the code base beside their goals, to out/house.json
	@$(VENV)/bin/python tools/house.py

docs: venv ## the pages of docs/ that are made from code, then the documentation as a site in out/site
	@$(VENV)/bin/python tools/docs.py
	@$(VENV)/bin/python tools/test_times.py --page
	@$(VENV)/bin/python tools/notebooks.py
	@$(VENV)/bin/pip install --quiet --disable-pip-version-check -r requirements/docs.txt
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --quiet
	@echo "The documentation stands in out/site/index.html."

demo: venv ## the recorded drives through the ROS processes: tables, pictures, report in out/demo
	$(VENV)/bin/vsense demo

bench: venv ## benchmarks to out/bench.json and BENCHMARKS.md
	$(VENV)/bin/python -m pytest test/benchmark --benchmark-enable --benchmark-json=out/bench.json
	$(VENV)/bin/python tools/benchmarks.py out/bench.json BENCHMARKS.md

# AGAINST="--quick" takes a part of it, within two minutes on an idle machine.
REVISION ?= $(shell git describe --tags --abbrev=0 2>/dev/null || git rev-list -1 --before=yesterday HEAD)
AGAINST ?=
bench-against: venv ## this checkout beside another REVISION, timed in turn: ratios, to out/bench.json
	$(VENV)/bin/python tools/bench_against.py "$(REVISION)" $(AGAINST)

genesis: venv ## the observer on the third Genesis lap, with parameters from the two others, to out/genesis.json
	$(VENV)/bin/python -m studies genesis

# AXE=axe.min.js of axe-core (npm pack axe-core) checks the accessibility as well.
studio-test: venv ## the workbench in the system's Chromium, from the car to the comparison of estimates, to out/studio.json
	$(VENV)/bin/python tools/studio_test.py $(if $(AXE),--axe $(AXE)) --film docs/pictures/studio.webp

own-car: venv ## a newcomer's way with cars that are not ours, to out/own_car.json
	$(VENV)/bin/python -m studies own-car

# LEUNG=--quick takes one seed and four of ten manoeuvres.
leung: venv ## the tables of Leung 2010 on GNSS/INS filters and models, beside his figures, to out/leung.json
	$(VENV)/bin/python -m studies leung $(LEUNG)

# BLIND="--cases 40" examines with a part of the cases. Ablations are run on a sample.
BLIND ?=
BLIND_RUN := PYTHONPATH=test $(VENV)/bin/python -m blind
blind: venv ## examine vsense explain: physics hidden in cars that are not our model, scores to out/blind.json
	$(BLIND_RUN) $(BLIND) make
	$(BLIND_RUN) $(BLIND) run
	for ablation in no_refit no_projection chi2_thresholds; do \
	    $(BLIND_RUN) --cases 60 $(BLIND) run --ablation $$ablation || exit 1; done
	$(BLIND_RUN) $(BLIND) score

# DBC=FOLDER also loads every DBC file below a folder, as that of commaai/opendbc.
DBC ?=
recordings: venv ## cases of public bug reports, planted faults and speeds of all formats, to out/recordings.json
	PYTHONPATH=test $(VENV)/bin/python -m recordings $(if $(DBC),--dbc $(DBC))

best: venv ## Best & Bogdanski 2016 on a twin: a car identified by Kalman filters, to out/best.json
	$(VENV)/bin/python -m studies best

thesis: venv ## the tables of Rodríguez 2020 beside ours, to out/thesis.json
	$(VENV)/bin/python -m studies thesis

road: venv ## forces and attitudes on roads that are not flat, to out/road.json
	$(VENV)/bin/python -m studies road

truth: venv ## what is published against what it says of itself, on all drives, to out/truth.json
	$(VENV)/bin/python -m studies truth

# FAULTS="--sample 150 --seed 7" takes other rows.
FAULTS ?=
faults: venv ## every part of every sensor that fails in every way: 1,040 rows, to out/truth.json
	$(VENV)/bin/python -m studies faults $(FAULTS)

bags: venv ## regenerate the manoeuvres in bags/ bit by bit
	$(VENV)/bin/python -m studies bags

# Debian 12 and Ubuntu 24.04. Needs root for apt, or the packages there already.
HW_PACKAGES := verilator iverilog yosys make g++ gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user \
	gcc-aarch64-linux-gnu libc6-dev-arm64-cross cppcheck
hw-tools: venv ## what simulating, synthesising and cross-compiling need; no other target needs any of it
	apt-get update -qq
	DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(HW_PACKAGES)
	$(VENV)/bin/pip install --quiet -r requirements/hw.txt

# Not of `make test`: compiling all variants takes minutes.
HW_PYTHON := PYTHONPATH=$(CURDIR):$(CURDIR)/hw/test PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(VENV)/bin/python
hw: venv ## the units by cocotb and by proof, and the resources of all variants on Xilinx 7-series
	$(HW_PYTHON) hw/test/cocotb_units.py
	$(HW_PYTHON) hw/formal/prove.py
	$(HW_PYTHON) hw/registers.py
	$(HW_PYTHON) hw/synthesise.py xc7

hw-timing: venv ## place and route on ECP5, for the clock: half an hour
	$(HW_PYTHON) hw/synthesise.py ecp5

arm: venv ## instructions and stack of the exported observer on Cortex-A9, A53 and R52, to out/arm.json
	PYTHONPATH=. $(VENV)/bin/python tools/arm/count.py

exports: venv ## sizes of exported C, two exports in one program, MISRA C:2012, to out/exports.json and docs/misra.md
	PYTHONPATH=. $(VENV)/bin/python tools/exports.py

accelerator: venv ## bits, clocks, resources and latency of the accelerator, to out/accelerator.json and docs
	-PYTHONPATH=. $(VENV)/bin/python tools/arm/count.py
	-PYTHONPATH=. $(VENV)/bin/python tools/exports.py
	$(VENV)/bin/python -m studies accelerator
	PYTHONPATH=. $(VENV)/bin/python tools/accelerator_page.py out/accelerator.json docs

# VEHICLE="--soak 1 transforms" chooses checks by parts of their names, and a soak of one minute.
VEHICLE ?=
vehicle: venv ## what is tried on the nodes from outside, half an hour of soak among it, to out/vehicle.json
	PYTHONPATH=test:test/node $(VENV)/bin/python -m vehicle $(VEHICLE)

# FUZZ="--inputs 10000" takes a part of them. COVERAGE="--runs 1000000 --seconds 0" gives a million to every parser, in hours;
# shorter runs go on from each other, as long as out/corpus stays.
FUZZ ?=
COVERAGE ?=
fuzz: venv ## a million wrong inputs to everything that reads, then inputs chosen by coverage, to out/fuzz.json
	PYTHONPATH=test:test/node $(VENV)/bin/python -m fuzz $(FUZZ)
	PYTHONPATH=test:test/node $(VENV)/bin/python -m fuzz.coverage $(COVERAGE)

release: venv ## wheel, source archive and Debian source package, each installed and tried, to out/release
	$(VENV)/bin/pip install --quiet -r requirements/release.txt
	$(VENV)/bin/python tools/release.py

clean: ## remove everything that a target made, environments included
	rm -rf $(VENV) .venv-numpy1 out build install log dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
