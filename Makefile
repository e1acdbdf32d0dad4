# Two commands for a fresh machine with Python 3.11: make demo, make test.
PYTHON ?= python3
BIN = .venv/bin
.DEFAULT_GOAL := help

help:
	@echo "make demo    install, scan a ladder in clear and milky water, write a report"
	@echo "make test    install, then lint, type check, import contracts and tests"
	@echo "make study   the long statistical studies (minutes)"
	@echo "make bench   speed against peers and limits, measured in one run"
	@echo "make clean   remove what the others made"

.venv/installed-all: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "amulor needs Python 3.11 or newer, found " + sys.version.split()[0] + "; call make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all]'
	@touch $@

.venv/installed-test: .venv/installed-all
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[all,test]'
	@touch $@

demo: .venv/installed-all
	$(BIN)/amulor demo --output amulor-demo --overwrite

lint: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/python -m pytest

study: .venv/installed-test
	$(BIN)/python -m pytest -m study

bench: .venv/installed-test
	@for case in benchmarks/time_*.py; do $(BIN)/python $$case || exit 1; done

clean:
	rm -rf .venv amulor-demo foam-transients

.PHONY: help demo lint test study bench clean
