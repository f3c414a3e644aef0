# `make demo` and `make test` need Python 3.11 or newer, make, and a network to a package index the first time.
# PYTHON=python3.12 chooses the interpreter that .venv is made with.

PYTHON ?= python3
BIN := .venv/bin
OLD := Python 3.11 or newer is needed; name one, e.g.: make PYTHON=python3.12

export OMP_NUM_THREADS ?= 1

.PHONY: help demo test test-ci test-all lowest audit fuzz study lint docs site bench pictures clean

help:
	@echo "make demo   diagnose a real robot's recording and leave the report in flexjoint-demo/"
	@echo "make test   make lint, and tests"
	@echo "make test-ci   these and long tests, which diagnose a lot: half an hour or more; .ci/run runs them"
	@echo "make test-all   these and the longest ones: an hour or more; before a release"
	@echo "make lowest   tests of the core with the lowest versions that pyproject.toml allows; some minutes"
	@echo "make audit   known vulnerabilities of what is installed; pip-audit asks the package index"
	@echo "make fuzz   hostile input to every reader and the main commands; an hour, EXAMPLES=300 for some minutes"
	@echo "make study  some 2000 planted recordings diagnosed and counted: two or three hours; stop it and it goes on"
	@echo "make lint   style, types and who imports whom"
	@echo "make docs   regenerate effects.md, settings.md, limits.md in docs/reference and the tables of exporting.md and architecture.md"
	@echo "make site   the documentation as a site in build/site/html, with the demo's report; some minutes the first time"
	@echo "make pictures   run all notebooks and draw their stored pictures anew; needs Chromium"
	@echo "make bench  speed and error of a step against Pinocchio and MuJoCo"
	@echo "make clean  remove .venv and everything that was built"

demo: .venv/.demo
	$(BIN)/flexjoint demo

# a file's tests share what they plant and build; in order, so that the long ones do not come last
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test: lint
	$(PYTEST) -m "not thorough and not exhaustive"

test-ci: lint
	$(PYTEST) -m "not exhaustive"

test-all: lint
	$(PYTEST)

# in an environment of its own; uv resolves to the lowest versions, which pip cannot
LOWEST := build/lowest
LOWEST_EXTRAS := report,control,example-robots,jit,ros,hdf5
lowest: | $(BIN)/python
	$(BIN)/python -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
	    --editable '.[$(LOWEST_EXTRAS)]'
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python pytest hypothesis jsonschema
	$(LOWEST)/bin/python -m pytest -m "not thorough and not exhaustive" tests/effects tests/model tests/simulation tests/recording

# in an environment of its own, so that only what flexjoint needs is asked for
AUDIT := build/audit
audit: .venv/.test
	$(BIN)/python -m venv --clear $(AUDIT)
	$(AUDIT)/bin/python -m pip install --quiet --disable-pip-version-check pip-audit
	$(AUDIT)/bin/pip-audit --strict --skip-editable --progress-spinner off \
	    --path "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"

# new inputs each time, EXAMPLES of them for each test; what breaks goes into tests/fuzz/corpus
EXAMPLES ?= 3000
fuzz: .venv/.test
	FLEXJOINT_FUZZ=$(EXAMPLES) $(PYTEST) tests/fuzz

# SHARD=1/2 and SHARD=2/2 share the work; STUDY is the folder that holds what is done
STUDY ?= study-results
SHARD ?= 1/1
study: .venv/.test
	PYTHONPATH=tests:. $(BIN)/python -m study run --out $(STUDY) --shard $(SHARD)
	PYTHONPATH=tests:. $(BIN)/python -m study table --out $(STUDY) --page docs/studies/diagnosis_study.md

lint: .venv/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/.demo
	$(BIN)/flexjoint effects --markdown > docs/reference/effects.md.new
	mv docs/reference/effects.md.new docs/reference/effects.md
	$(BIN)/python -c "from flexjoint.diagnosis.settings import settings_page; print(settings_page(), end='')" > docs/reference/settings.md.new
	mv docs/reference/settings.md.new docs/reference/settings.md
	$(BIN)/python -c "from flexjoint.core.limits import limits_page; print(limits_page(), end='')" > docs/reference/limits.md.new
	mv docs/reference/limits.md.new docs/reference/limits.md
	$(BIN)/python docs/modules.py
	$(BIN)/python docs/export_table.py

# the demo's report is made once; the gallery's pictures, again where an effect has changed
site: .venv/.docs flexjoint-demo/report.html
	$(BIN)/python docs/site/build.py build/site --report flexjoint-demo/report.html
	@echo "open build/site/html/index.html"

flexjoint-demo/report.html: | .venv/.demo
	$(BIN)/flexjoint demo

pictures: .venv/.test
	FLEXJOINT_PICTURES=$(CURDIR)/notebooks/pictures \
	$(BIN)/python -m pytest tests/acceptance/project/test_notebooks.py -k runs_and_draws

bench: .venv/.bench
	$(BIN)/python -m bench

# installed once; again when pyproject.toml changes
.venv/.demo: pyproject.toml | $(BIN)/python
	@echo "installing into .venv, once; this may take some minutes"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[report]'
	touch $@

.venv/.test: pyproject.toml | $(BIN)/python
	@echo "installing into .venv, once; this may take some minutes"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@ .venv/.demo

.venv/.docs: pyproject.toml .venv/.test | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

.venv/.bench: pyproject.toml .venv/.test | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(OLD)"; exit 1; }
	$(PYTHON) -m venv .venv

clean:
	rm -rf .venv build dist flexjoint-demo flexjoint-paper .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
