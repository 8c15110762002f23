# Everything that a checkout can do. Needs make and Python 3.11 or newer, nothing else:
# packages go into .venv/<version>, locked by hash, so the first call takes a few minutes.

PYTHON ?= python3
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
VENV := .venv/$(VERSION)
RUN := $(VENV)/bin/python
CORE := $(VENV)/.core
DEV := $(VENV)/.dev

CONFIG ?= configs/pessoles2009_plane.yaml
NAME = $(basename $(notdir $(CONFIG)))
CONFIGS := $(wildcard configs/*.yaml)
NOTEBOOKS := $(wildcard notebooks/*.py)
WORKERS ?= 2
PYTEST_ARGS ?=

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help python fit test test-all lint notebooks notebooks-check sensitivity bench clean

help:
	@echo 'make fit          tune the plane part of the paper; CONFIG=file.yaml for another'
	@echo 'make test         run the test suite; PYTEST_ARGS=... for some of it'
	@echo 'make test-all     the same with its slow tests, which take minutes more'
	@echo 'make lint         check format, style and types'
	@echo 'make notebooks    run the notebooks and write their .ipynb'
	@echo 'make sensitivity  elasticities of every config, into build/'
	@echo 'make bench        time the process model and its gradient'
	@echo 'make clean        remove what was built; the virtual environments stay'
	@echo
	@echo 'PYTHON=python3.12 make ... uses another Python; the environment is .venv/<version>.'

# A file on disk stands for each environment, so that a second call has nothing to do.
# The development packages hold the core ones: where they are in, core is in too. Byte code
# is made on all cores, which pip does on one; what is no Python in a package stays as it is.
COMPILE = $(RUN) -m compileall -qq -j 0 $(VENV)/lib || true

python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "polishopt needs Python 3.11 or newer, but '$(PYTHON)' is" \
	    "$$($(PYTHON) --version 2>&1 | tail -n 1). Say which one to use:" \
	    "make PYTHON=python3.12 ..." >&2; exit 1; }

$(VENV)/bin/pip: | python
	$(PYTHON) -m venv $(VENV)

$(DEV): requirements-dev.lock pyproject.toml | $(VENV)/bin/pip
	$(RUN) -m pip install --quiet --no-compile --require-hashes -r requirements-dev.lock
	$(RUN) -m pip install --quiet --no-deps -e .
	@$(COMPILE)
	@touch $(CORE) $@

$(CORE): requirements.lock pyproject.toml | $(VENV)/bin/pip
	$(RUN) -m pip install --quiet --no-compile --require-hashes -r requirements.lock
	$(RUN) -m pip install --quiet --no-deps -e .
	@$(COMPILE)
	@touch $@

fit: $(CORE)
	$(RUN) -m polishopt.fit $(CONFIG) -o runs/$(NAME)

# --dist loadfile keeps a file's tests together, so that they share what is compiled
test: $(DEV)
	$(RUN) -m pytest -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

test-all: PYTEST_ARGS += -m ""
test-all: test

lint: $(DEV)
	$(RUN) -m ruff format --check
	$(RUN) -m ruff check
	$(RUN) -m basedpyright --pythonpath $(RUN)

notebooks: $(DEV)
	$(RUN) -m jupytext --to ipynb --execute --set-kernel python3 $(NOTEBOOKS)

# Runs copies, and compares the sources: outputs may differ between machines.
notebooks-check: $(NOTEBOOKS:%.py=check-%)

check-notebooks/%: $(DEV)
	@mkdir -p build/notebooks; pair=notebooks/$*.ipynb; source=notebooks/$*.py; \
	  $(RUN) -m jupytext --to py:percent --opt notebook_metadata_filter=-all \
	    --output build/notebooks/$*.pair.py --quiet $$pair && \
	  $(RUN) -m jupytext --to py:percent --opt notebook_metadata_filter=-all \
	    --output build/notebooks/$*.source.py --quiet $$source && \
	  diff build/notebooks/$*.source.py build/notebooks/$*.pair.py || { \
	    echo "$$pair is out of step with $$source: run 'make notebooks'." >&2; exit 1; }; \
	  test $$(wc -c < $$pair) -lt 300000 || { \
	    echo "$$pair has 300 kB or more: make its outputs smaller." >&2; exit 1; }; \
	  echo "running $$source"; \
	  cd notebooks && ../$(RUN) -m jupytext --to ipynb --execute --set-kernel python3 \
	    --run-path . --output ../build/notebooks/$*.ipynb $*.py

sensitivity: $(CONFIGS:configs/%.yaml=sensitivity/%)

sensitivity/%: $(DEV)
	@echo "polishopt.sensitivity configs/$*.yaml"; \
	  $(RUN) -m polishopt.sensitivity configs/$*.yaml --samples 32 -o build/$*

bench: $(CORE)
	$(RUN) benchmarks/bench_polish.py

clean:
	rm -rf build dist runs .pytest_cache .ruff_cache *.egg-info
	find polishopt tests benchmarks notebooks -name __pycache__ -type d -prune -exec rm -rf {} +
