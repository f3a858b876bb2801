# The two commands of this compendium: make reproduce, make test. `make help` lists the rest.

PYTHON ?= python3
BIN := .venv/bin
NOTEBOOKS := $(sort $(wildcard notebooks/*.ipynb))
# Notebooks run side by side: one thread of linear algebra each. Whatever the caller's environment
# says, figures and output are the same.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MPLBACKEND := module://matplotlib_inline.backend_inline
export PYTHONWARNINGS := ignore::DeprecationWarning
.DELETE_ON_ERROR:
.PHONY: help reproduce test lint data replay machines lowest bench lab notebooks lock clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

reproduce: $(BIN)/ready  ## run all notebooks; regenerate figures/ and the ledger
	@$(BIN)/python -m rodlib.reproduce

test: $(BIN)/ready lint  ## lint, unit tests, and the committed notebooks against a fresh run
	$(BIN)/pytest -q
	$(BIN)/pytest -q --nbval --nbval-current-env $(NOTEBOOKS)

lint: $(BIN)/ready  ## ruff on modules, tests and notebooks
	$(BIN)/ruff check
	$(BIN)/ruff format --check

data: $(BIN)/ready  ## record the logs of the virtual rig in data/rig anew
	$(BIN)/python -m rodlib.rig

replay: $(BIN)/ready  ## replay a log of your own: make replay LOG=path; writes to build/ only
	@test -n "$(LOG)" || { echo "name a log: make replay LOG=path"; exit 2; }
	@mkdir -p build
	$(BIN)/papermill --cwd notebooks -p log "$(abspath $(LOG))" -p no_learning "" \
		notebooks/05-experiment-replay.ipynb build/replay.ipynb

machines: $(BIN)/ready  ## test and reproduce with other processors' arithmetic (long)
	$(BIN)/python tests/machines.py

lowest: $(BIN)/ready  ## unit tests with the oldest packages that pyproject.toml admits
	@mkdir -p build
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip compile --quiet pyproject.toml --resolution lowest-direct --no-emit-index-url \
		--output-file build/lowest.txt
	$(BIN)/uv pip install --quiet --python build/lowest --constraints build/lowest.txt -e ".[dev]"
	build/lowest/bin/pytest -q -W ignore::DeprecationWarning -W ignore::FutureWarning

bench: $(BIN)/ready  ## time the synthesis; rewrite the README's performance section
	@mkdir -p build
	$(BIN)/pytest -q tests/benchmarks/bench_synthesis.py --benchmark-json=build/benchmark.json \
		--benchmark-columns=median,min,max,rounds
	$(BIN)/python tests/benchmarks/report.py build/benchmark.json

lab: $(BIN)/ready  ## open the notebooks in JupyterLab
	$(BIN)/jupyter lab --notebook-dir=notebooks

notebooks: $(BIN)/ready  ## execute the tracked notebooks in place, before a commit
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--ExecutePreprocessor.record_timing=False $(NOTEBOOKS)

lock: $(BIN)/ready  ## resolve the dependencies of pyproject.toml anew: the only writer of environment.lock
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --fork-strategy fewest --upgrade \
		--generate-hashes --no-emit-index-url --no-emit-find-links \
		--custom-compile-command "make lock" --quiet --output-file environment.lock

clean:  ## remove build/ and the environment
	rm -rf build .venv

$(BIN)/ready: environment.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or newer is needed: make PYTHON=...")'
	@echo "creating the environment from environment.lock (once, some minutes) ..."
	@$(PYTHON) -m venv --clear .venv
	@$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r environment.lock
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@
