# Every target makes what it needs first: `make demo` works in a fresh clone.
PYTHON ?= python3
BIN := .venv/bin

# -qq leaves errors visible and hides warnings about package indexes that are not there.
PIP := PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install -qq -c constraints.txt
RECIPE := pyproject.toml constraints.txt

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test lint bench docs docs-papers docs-examples clean

help:  ## List the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-7s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: .venv/.core  ## Tune the bench's gains over 64 drives; table and plots in results/demo
	@rm -rf results/demo  # tune overwrites no results
	$(BIN)/gearlash tune bench_switched --out results/demo

test: .venv/.test  ## Run the tests that are not marked slow
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow"

lint: .venv/.dev  ## Check style, format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

bench: .venv/.bench  ## Measure speed next to C, numba, SciPy and diffrax; half an hour
	$(BIN)/python benchmarks/suite.py

docs: .venv/.docs  ## Build the documentation: runs its code blocks, the examples, both papers
	@$(MAKE) --no-print-directory -j 2 docs-papers docs-examples
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

docs-papers:
	@mkdir -p results/docs
	$(BIN)/gearlash reproduce all --out results/docs/papers > results/docs/papers.txt

docs-examples:
	@mkdir -p results/docs/examples
	@for script in examples/*.py; do \
	  echo $$script; $(BIN)/python $$script results/docs/examples \
	    > results/docs/examples/$$(basename $$script .py).txt || exit 1; done

clean:  ## Remove results and caches; .venv stays
	rm -rf results dist .pytest_cache .ruff_cache
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +

# One stamp file per set of extras: nothing is installed again until a recipe file changes.
.venv/.core: $(RECIPE) | $(BIN)/python
	@echo "Installing gearlash into .venv (the first time takes a minute or two) ..."
	@$(PIP) -e .
	@touch $@

.venv/.test .venv/.bench .venv/.dev .venv/.docs: .venv/.%: $(RECIPE) | $(BIN)/python
	@echo "Installing gearlash[$*] into .venv (the first time takes a minute or two) ..."
	@$(PIP) -e '.[$*]'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "gearlash needs Python 3.11 or newer, but $(PYTHON) is $$($(PYTHON) --version 2>&1);" \
	    "name another one: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -m venv .venv
