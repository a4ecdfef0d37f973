# `make demo` and `make test` need Python 3.11+ and make, nothing else.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin

.PHONY: doors release docs audit lock locked bench-model bench-ingest soak demo test check unit lint types style kernels clean samples bench-accuracy

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "flysid needs Python 3.11 or newer; try: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -e '.[dev,docs,fleet,plot,studio,xlsx]'
	touch $@

demo: $(VENV)/.installed  ## the main job on embedded data, ends with a report
	$(BIN)/flysid demo -o flysid-demo --force

# The type check has one core for a minute: beside it the kernels are compiled, and the first tests run.
test: $(VENV)/.installed  ## lint, types, import layers, tests
	$(MAKE) --no-print-directory -j 3 types style unit

# Three workers for two cores: many tests wait for a browser, a server or a link. They share what a file's tests
# share (worksteal keeps neighbours together); BLAS with a thread each.
unit: kernels  ## the tests alone
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist worksteal

doors: kernels  ## what a user types, as processes; `make test` has them among its tests
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal tests/doors

check: test

lint: types style

types: $(VENV)/.installed
	$(BIN)/mypy

style: $(VENV)/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports

kernels: $(VENV)/.installed  ## compiled once, beside the type check, for all that the tests start
	$(BIN)/python -m tests.kernels

bench-ingest: $(VENV)/.installed  ## readers against their peers, ratios in CPU time
	$(BIN)/python -m bench.bench_ingest

soak: $(VENV)/.installed  ## hours: long campaigns (docs/reliability.md), the verdict against known truth
	$(BIN)/python -m bench.verdict_coverage 1000
	$(BIN)/python -m bench.monte_carlo 1000
	FLYSID_ALL_SIZES=1 $(BIN)/python -m pytest tests/flysid/studio/test_journey.py
	ALL_DOORS=1 $(BIN)/python -m pytest tests/doors
	DRAWS=50 $(BIN)/python -m pytest tests
	$(BIN)/python -m soak

bench-model: $(VENV)/.installed  ## linear and fuzzy models against their peers (installed with pip beforehand), ratios
	$(BIN)/python -m bench.bench_model
	$(BIN)/python -m bench.bench_ts

bench-accuracy: $(VENV)/.installed  ## free-run accuracy on ../shared/benchmarks, default settings
	$(BIN)/python -m bench.accuracy

# The stamp says that the site is whole: the tests then look at it instead of building another one.
docs: $(VENV)/.installed  ## the documentation as a site in docs/_build, without network; warnings are errors
	rm -f docs/_build/.whole
	$(BIN)/python -m sphinx -n -W --keep-going -q -b html docs docs/_build
	touch docs/_build/.whole

audit: $(VENV)/.installed  ## licences, locked versions, vendored files; needs no network
	$(BIN)/python -m tests.audit

lock: $(VENV)/.installed  ## requirements.lock anew, for all platforms
	$(BIN)/python -m pip install --quiet uv
	echo '# Exact versions with hashes, for every platform. Made by `make lock`; used by `make locked`; judged by `make audit`.' > requirements.lock
	$(BIN)/uv pip compile pyproject.toml --all-extras --generate-hashes --universal --python-version 3.11 \
		--no-header --no-annotate --no-emit-index-url --no-emit-find-links --upgrade >> requirements.lock

locked:  ## an environment of exactly the locked versions, every hash checked
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --no-deps -e .
	touch $(VENV)/.installed

# CHECKS: what must pass first. ADDRESS=https://... : where the repository can be read, for the archives' links.
CHECKS ?= test audit docs
release: $(VENV)/.installed  ## wheel and source archive in dist/, checked, and a tag: all but the upload
	$(BIN)/python -m pip install --quiet build twine
	$(BIN)/python -m tests.release --checks '$(CHECKS)' $(ADDRESS)

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache flysid-demo .bench docs/_build

samples: $(VENV)/.installed  ## sample_logs/, bit for bit
	$(BIN)/python -m flysid synth -o sample_logs --force --no-truth --plan multisine --seed 1 --duration 30 --format tlog
	$(BIN)/python -m flysid synth -o sample_logs --force --no-truth --plan steps --seed 2 --duration 30 --format tlog
	$(BIN)/python -m flysid synth -o sample_logs --force --no-truth --plan multisine --seed 3 --duration 30 --format mcap
	$(BIN)/python -m flysid synth -o sample_logs --force --no-truth --plan steps --seed 4 --duration 30 --format mcap
	cd sample_logs && sha256sum *.mcap *.tlog > SHA256SUMS
