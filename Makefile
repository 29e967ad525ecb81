# `make demo` and `make test` set up everything they need in .venv and are quick the second time.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# detects an outdated environment without running pip
STAMP = $(VENV)/.installed-$(1)

SHELL := /bin/bash
.PHONY: demo tools test verify coverage test-rtl test-aarch64 test-pythons test-oldest lint types site bench results eva clean

demo: $(call STAMP,run)
	$(BIN)/edge-vpr demo -o results/demo --overwrite

# programs that tests run, from Debian and by root; a test without its program is skipped and says so
TOOLS := make gcc g++ cmake gcc-arm-none-eabi gcc-avr avr-libc simavr qemu-system-arm iverilog verilator yosys \
         nextpnr-ice40 fpga-icestorm frama-c-base cppcheck mosquitto mosquitto-clients openssl chromium shellcheck systemd udev
APT := apt-get -q -o Acquire::Retries=2 -o Acquire::http::Timeout=30 -o DPkg::Lock::Timeout=300

# one that apt does not know or cannot reach is named, and does not keep the others away
tools:
	-$(APT) update
	-DEBIAN_FRONTEND=noninteractive $(APT) install --yes --no-upgrade --no-install-recommends --fix-missing \
	    $$(for tool in $(TOOLS); do apt-cache show $$tool >/dev/null 2>&1 && echo $$tool; done)
	@for tool in $(TOOLS); do dpkg-query -W -f '$${Status}' $$tool 2>/dev/null | grep -q 'ok installed' || \
	    echo "make tools: $$tool is not installed: tests that need it are skipped"; done

# what has compiled kernels runs a second time in plain Python
KERNELS := cleaning counters distances filter_run localiser matches own_mean pipeline \
           place_filter simulate_pixels stream_protocols windows

PLAIN := NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q -n auto $(wildcard $(KERNELS:%=tests/*/test_%.py))

# what guards a change
test: lint types
	$(BIN)/python -m pytest -q -n auto --dist worksteal -m "not slow"

# the rest: slow tests, and kernels in plain Python; says how long each part takes
verify: $(call STAMP,test)
	time $(BIN)/python -m pytest -q -n auto --dist worksteal -m slow
	time $(PLAIN)

# of what has kernels, with the compiler off
coverage: $(call STAMP,test)
	$(PLAIN) --cov

# the hardware core, with the tools of docs/hardware.md
test-rtl: $(call STAMP,test)
	$(BIN)/python -m pytest tests/firmware_model/test_hardware.py

# kernels of distances under aarch64, emulated by qemu; PART=whole runs all but commands and pages
test-aarch64:
	sh tests/in_debian.sh arm64 3.13

# with the Python versions of other Debian releases; only the workflow has 3.12
test-pythons:
	PART=whole sh tests/in_debian.sh amd64 3.13
	PART=whole sh tests/in_debian.sh amd64 3.14

# with the oldest libraries that pyproject.toml allows, which may warn of the newer ones they use
test-oldest:
	$(PYTHON) -m venv .oldest
	.oldest/bin/python -m pip install --quiet uv
	.oldest/bin/uv pip install --quiet --python .oldest/bin/python --resolution lowest-direct --editable '.[test]'
	.oldest/bin/python -m pytest -n auto --dist worksteal -m "not slow" -W ignore::DeprecationWarning

# the firmware by abstract interpretation, of all sizes; a minute
eva: $(call STAMP,test)
	$(BIN)/python -m firmware_model.verification.eva

lint: $(call STAMP,test)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(call STAMP,test)
	$(BIN)/mypy

# site/index.html; a warning is an error
site: $(call STAMP,docs)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(call STAMP,bench)
	$(BIN)/python -m pytest tools/bench --write=docs/results/benchmarks.csv
	$(BIN)/python tools/bench/latency.py docs/results
	$(BIN)/python tools/site/tables.py

# tables and figures of the pages: all experiments that need no downloads, and with DATA=DIR those on recorded drives;
# RESUME=--resume goes on after an interrupt
SEEDS ?= 5
results: $(call STAMP,test)
	$(BIN)/python -m lab all -o docs/results --seeds $(SEEDS) $(if $(DATA),--data $(DATA)) $(RESUME)
	$(BIN)/python tools/site/tables.py

clean:
	rm -rf $(VENV) .debian .oldest results site

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(call STAMP,run): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(call STAMP,test): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	# its libraries are for other languages, and one of them replaces a module of Python
	-$(BIN)/python -m pip install --quiet --no-deps universalmutator
	@touch $@ $(call STAMP,run)

$(call STAMP,docs): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@ $(call STAMP,run)

$(call STAMP,bench): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	@touch $@ $(call STAMP,run)
