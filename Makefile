# Everything goes into this checkout: .venv (Python), frontend/node_modules (dashboard build), app/static (built dashboard).
.PHONY: run test long audit sbom bench safety soak dashboard site wheel figures screenshots reference wire lock clean
.DELETE_ON_ERROR:
.NOTPARALLEL:

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
NPM := frontend/npm.sh
DASHBOARD_SOURCES := $(shell find frontend/src frontend/scripts frontend/public -type f ! -name wire.ts 2>/dev/null) \
	frontend/index.html frontend/package.json frontend/vite.config.js frontend/tsconfig.json

run: $(VENV)/.installed app/static/index.html ## start with the simulated grasper and a demonstration
	$(BIN)/graspwatch serve --demo

# a live tool beside a browser, or whose reaction is measured: one at a time, on a machine that does nothing else
ALONE := tests/browser tests/end_to_end/test_recording.py tests/end_to_end/test_service.py tests/faults/live

test: $(VENV)/.installed app/static/index.html ## the whole test suite
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/python -m compileall -q app acquisition estimator config graspwatch  # each test that starts the program starts five
	$(BIN)/python -m pytest -m "not long" -n 2 --dist loadscope tests $(ALONE:%=--ignore %)
	$(BIN)/python -m pytest -m "not long" $(ALONE)

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
	$(BIN)/python -m app.wire_schema

lock: ## renew the locked versions (needs uv)
	uv pip compile -q pyproject.toml --universal --python-version 3.11 --no-emit-index-url --no-annotate -o requirements.lock
	uv pip compile -q pyproject.toml --extra dev --universal --python-version 3.11 --no-emit-index-url --no-annotate \
		-c requirements.lock -o requirements-dev.lock

clean: ## remove everything that was installed or built
	rm -rf $(VENV) frontend/node_modules app/static build *.egg-info

$(VENV)/.installed: requirements-dev.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Graspwatch needs Python 3.11 or later; found: $$($(PYTHON) --version 2>&1). Set PYTHON=/path/to/python3."; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
		{ echo "A virtual environment cannot be made. On Debian: apt install python3-venv; then repeat."; rm -rf $(VENV); exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

app/static/index.html: $(VENV)/.installed $(DASHBOARD_SOURCES) frontend/package-lock.json
	$(NPM) ci --prefix frontend --no-audit --no-fund --loglevel=error
	$(NPM) run build --prefix frontend --silent
	@touch $@
