SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON := .venv/bin/python
WORKERS ?= 2 # test processes; each may hold torch and Mitsuba
CXX_SOURCES = $(shell find sdk python/bindings training/bindings -name '*.cpp' -o -name '*.hpp' -o -name '*.h' -o -name '*.c')
PY_SOURCES = python training tests tools benchmarks

.PHONY: help setup build demo test test-long sanitize lint format wheel lock clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: ## Install and build everything into .venv/ (system packages through apt: root or sudo)
	@tools/setup

build: setup ## Build the SDK with its tests, examples and benchmarks into build/dev/
	@cmake --preset dev >build/dev.log 2>&1 || { cat build/dev.log; exit 1; }
	@cmake --build --preset dev

demo: setup ## Render, denoise and compare one scene: a table, a picture and a page in out/demo/
	@PYTHONPATH=tools $(PYTHON) -m demo

test: build ## Run the C++ and the Python tests, but for the long ones
	ctest --preset dev
	$(PYTHON) -m pytest -n $(WORKERS) --dist loadfile -m "not long"

test-long: build ## Run the tests that take minutes
	$(PYTHON) -m pytest -m long

sanitize: setup ## Run the C++ tests under the address, undefined-behaviour and thread sanitizers
	cmake --preset asan && cmake --build --preset asan && ctest --preset asan
	cmake --preset tsan && cmake --build --preset tsan && ctest --preset tsan

lint: setup ## Check style and types of the C++ and Python sources
	$(PYTHON) -m ruff check $(PY_SOURCES)
	$(PYTHON) -m ruff format --check $(PY_SOURCES)
	.venv/bin/clang-format --dry-run --Werror $(CXX_SOURCES)
	$(PYTHON) -m mypy

format: setup ## Bring the sources into the style that lint asks for
	$(PYTHON) -m ruff check --fix $(PY_SOURCES)
	$(PYTHON) -m ruff format $(PY_SOURCES)
	.venv/bin/clang-format -i $(CXX_SOURCES)

wheel: setup ## Build the wheel into dist/
	$(PYTHON) -m pip wheel -q --no-deps --no-build-isolation -w dist .

lock: setup ## Write the installed versions into requirements/constraints.txt
	@tools/lock

clean: ## Remove what was built; .venv/ stays
	rm -rf build dist out .mypy_cache .pytest_cache .ruff_cache .hypothesis
