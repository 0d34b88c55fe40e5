# Everything goes into this checkout: .venv (Python), frontend/node_modules (dashboard build), app/static (built dashboard).
.PHONY: run test quick long audit sbom bench safety soak dashboard site wheel figures screenshots reference wire lock clean
.DELETE_ON_ERROR:

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check
NPM := frontend/npm.sh
QUICK := tests/config tests/acquisition tests/estimator tests/app/recordings tests/app/index tests/app/people/test_parts.py
DASHBOARD_SOURCES := $(shell find frontend/src frontend/scripts frontend/public -type f ! -name wire.ts 2>/dev/null) \
	frontend/index.html frontend/package.json frontend/vite.config.js frontend/tsconfig.json

run: $(VENV)/bin/python ## start with the simulated grasper and a demonstration
	@$(MAKE) --no-print-directory -j 2 $(VENV)/.running app/static/index.html
	@echo "Starting; the very first start compiles the filters, which takes up to half a minute."
	@# nothing is compiled yet: without bytecode every start would take ten seconds longer
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/graspwatch serve --demo

test: $(VENV)/.installed app/static/index.html ## the whole test suite
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/basedpyright
	$(BIN)/lint-imports
	$(NPM) run lint --prefix frontend --silent
	$(NPM) test --prefix frontend --silent
	@# compiled once here, not by each test that starts the program
	$(BIN)/python -m compileall -q app acquisition estimator config graspwatch
	$(BIN)/graspwatch run trapezoid_2hz --tissue liver --cycles 1 >/dev/null
	$(BIN)/python -m pytest -m "not long and not alone" -n 2 --dist loadfile --max-worker-restart 0
	$(BIN)/python -m pytest -m "alone and not long" -n 1

quick: $(VENV)/.installed ## what needs neither a service nor a browser; for another Python: make quick PYTHON=python3.13 VENV=.venv-3.13
	$(BIN)/python -m pytest -m "not long and not alone" -n 2 --dist loadfile --max-worker-restart 0 $(QUICK)

long: $(VENV)/.installed app/static/index.html ## the tests that `make test` leaves out, a quarter of an hour
	$(BIN)/python -m pytest -m long tests

audit: $(VENV)/.installed ## known vulnerabilities of the locked versions; says so where nobody could be asked
	$(BIN)/python .ci/audit.py

sbom: $(VENV)/.installed ## what it is made of: CycloneDX, of the service and of the dashboard, in build/sbom
	@mkdir -p build/sbom
	$(BIN)/cyclonedx-py requirements requirements.lock --pyproject pyproject.toml --output-reproducible \
		-o build/sbom/service.cdx.json
	$(NPM) sbom --prefix frontend --sbom-format cyclonedx --omit dev --package-lock-only > build/sbom/dashboard.cdx.json

bench: $(VENV)/.installed app/static/index.html ## measure; prints the table, writes bench.json
	$(BIN)/python -m tests.benchmarks

safety: $(VENV)/.installed app/static/index.html ## inject all faults, write docs/safety.md from what was measured
	@mkdir -p build && rm -f build/reactions.jsonl
	$(BIN)/python -m pytest tests/faults $$($(BIN)/python docs/safety.py) --reactions build/reactions.jsonl; failed=$$?; \
		$(BIN)/python docs/safety.py build/reactions.jsonl && exit $$failed

SOAK_MINUTES ?= 60
soak: $(VENV)/.installed ## random faults for an hour (SOAK_MINUTES=10 for less); ends with an error at any violation
	$(BIN)/python -m tests.soak --minutes $(SOAK_MINUTES)

dashboard: app/static/index.html ## build the dashboard

wheel: $(VENV)/.installed app/static/index.html ## what other machines install, the dashboard in it: build/wheels
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir build/wheels .

site: $(VENV)/.installed ## the documentation as pages: build/site/index.html
	$(BIN)/mkdocs build --quiet --strict

screenshots: $(VENV)/.installed app/static/index.html ## take the dashboard in each of its states (needs Chromium)
	$(BIN)/python tests/screenshots.py

figures: $(VENV)/.installed ## run all studies, renew docs/estimation.md (needs Chromium)
	$(BIN)/python docs/figures.py

reference: $(VENV)/.installed ## renew docs/reference, which is generated
	$(BIN)/python docs/reference.py

wire: $(VENV)/.installed ## renew the schema that the dashboard's types are generated from
	$(BIN)/python -m app.messages.json_schema

lock: ## renew the locked versions (needs uv)
	uv pip compile -q pyproject.toml --universal --python-version 3.11 --no-emit-index-url --no-annotate -o requirements.lock
	uv pip compile -q pyproject.toml --extra dev --universal --python-version 3.11 --no-emit-index-url --no-annotate \
		-c requirements.lock -o requirements-dev.lock

clean: ## remove everything that was installed or built
	rm -rf $(VENV) frontend/node_modules app/static build *.egg-info

# what running needs; `make run` builds the dashboard meanwhile
$(VENV)/.running: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "Installing the program into $(VENV): about half a minute, longer where packages must be downloaded (300 MB)"
	@begin=$$(date +%s); $(PIP) --no-compile -r requirements.lock && PYTHONWARNINGS=ignore $(PIP) --no-deps -e . && \
		echo "Installing the program took $$(($$(date +%s) - begin)) s"
	@touch $@

# what tests, documentation and releases need as well
$(VENV)/.installed: requirements-dev.lock $(VENV)/.running
	@echo "Installing what tests need into $(VENV)"
	@# compiled once: tests start the program a hundred times, also where Python may write no bytecode
	@# the lock is complete; --no-deps, because openapi-python-client says that it needs an older typer, and works with this one
	@begin=$$(date +%s); $(PIP) --no-compile --no-deps -r requirements-dev.lock && $(BIN)/python -m compileall -q -j 0 $(VENV)/lib && \
		echo "Installing what tests need took $$(($$(date +%s) - begin)) s"
	@touch $@

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Graspwatch needs Python 3.11 or later; found: $$($(PYTHON) --version 2>&1). Set PYTHON=/path/to/python3."; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
		{ echo "A virtual environment cannot be made. On Debian: apt install python3-venv; then repeat."; rm -rf $(VENV); exit 1; }

app/static/index.html: $(DASHBOARD_SOURCES) frontend/package-lock.json | $(VENV)/bin/python
	@echo "Building the dashboard: about a quarter of a minute"
	@begin=$$(date +%s); $(NPM) ci --prefix frontend --no-audit --no-fund --loglevel=error && \
		$(NPM) run build --prefix frontend --silent >/dev/null && \
		echo "Building the dashboard took $$(($$(date +%s) - begin)) s"
	@touch $@
