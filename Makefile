# The two commands of this compendium: make reproduce, make test. `make help` lists the rest.

PYTHON ?= python3
BIN := .venv/bin
# One of each function that is long enough, some 300 in all.
MUTANTS := "*__mutmut_29"
NOTEBOOKS := $(wildcard notebooks/*.ipynb)
# Whatever the caller's environment says, figures and output are the same: its settings of Python
# and Jupyter do not count. Notebooks run side by side: one thread of linear algebra each.
unexport $(filter PYTHON% IPYTHON% JUPYTER% JPY% PYTEST% RODLIB% CONDA% VIRTUAL_ENV%,$(.VARIABLES))
unexport PIP_TARGET PIP_PREFIX PIP_ROOT PIP_USER
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MPLBACKEND := module://matplotlib_inline.backend_inline
export MATPLOTLIBRC := /dev/null
export IPYTHONDIR := $(CURDIR)/build/ipython
export JUPYTER_PREFER_ENV_PATH := 1
export PYTHONUTF8 := 1
export LC_ALL := C.UTF-8
export PYTHONWARNINGS := ignore::DeprecationWarning
.DELETE_ON_ERROR:
.PHONY: $(BIN)/ready help reproduce test lint data replay machines mutants lowest survey regions \
	plants peers renewal ageing peltier saturation boards solvers watch \
	study pages bench lab notebooks stubs lock clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

reproduce: $(BIN)/ready  ## run all notebooks; regenerate figures/ and the ledger
	@$(BIN)/python -m rodlib.paper.reproduce

test: $(BIN)/ready  ## lint, unit tests, the committed notebooks against a fresh run, a browser
	@$(BIN)/python tests/suite.py

lint: $(BIN)/ready  ## ruff on modules, tests and notebooks
	$(BIN)/ruff check
	$(BIN)/ruff format --check

data: $(BIN)/ready  ## record the logs of the virtual rig in data/rig anew
	$(BIN)/python -m rodlib.paper.rig_logs

# The path as it is: neither make nor the shell finds anything in it.
replay: export NAMED = $(value LOG)
replay: $(BIN)/ready  ## replay a log of your own: make replay LOG=path; writes to build/ only
	@test -n "$$NAMED" || { echo "name a log: make replay LOG=path"; exit 2; }
	@$(BIN)/python -m rodlib.paper.reproduce "$$NAMED"

machines: $(BIN)/ready  ## notebooks and tests with the rounding of other processors (long)
	$(BIN)/python tests/machines.py $(MACHINES)

mutants: $(BIN)/ready  ## change one thing in rodlib at a time and list what no test notices (long)
	$(BIN)/mutmut run $(MUTANTS)
	@$(BIN)/mutmut results | grep -v "not checked"

lowest: $(BIN)/ready  ## unit tests with the oldest packages that pyproject.toml admits
	@mkdir -p build
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip compile --quiet pyproject.toml --resolution lowest-direct --no-emit-index-url \
		--output-file build/lowest.txt
	$(BIN)/uv pip install --quiet --python build/lowest --constraints build/lowest.txt -e ".[dev]"
	build/lowest/bin/pytest -q -W ignore::DeprecationWarning -W ignore::FutureWarning

solvers: $(BIN)/ready  ## time solvers for the quadratic program of a trial within limits
	@$(BIN)/python tests/benchmarks/limits.py

survey: $(BIN)/ready  ## solve 550 problems for ordinary plants; count how it ends (some minutes)
	@$(BIN)/python tests/benchmarks/survey.py

regions: $(BIN)/ready  ## how often the truth is in an estimate's region, 25 kinds of records (20 minutes)
	@$(BIN)/python tests/benchmarks/regions.py

renewal: $(BIN)/ready  ## filters from a plant's own trials, against filters from its model (an hour)
	@$(BIN)/python tests/benchmarks/renewal.py

ageing: $(BIN)/ready  ## laws left alone, and laws that renew themselves, on a rod that drifts (minutes)
	@$(BIN)/python tests/benchmarks/ageing.py

peltier: $(BIN)/ready  ## what helps on a rig with Peltier elements, ten draws of 40 trials (minutes)
	@$(BIN)/python tests/benchmarks/peltier.py

saturation: $(BIN)/ready  ## learning within limits, for longer and with more draws (minutes)
	@$(BIN)/python tests/benchmarks/saturation.py

boards: $(BIN)/ready  ## what to measure next on a heater board, ten draws of each kind (minutes)
	@$(BIN)/python tests/benchmarks/boards.py

plants: $(BIN)/ready  ## ten kinds of plants the whole way, from a model to a log (a minute)
	@$(BIN)/python tests/benchmarks/whole_way.py

watch: $(BIN)/ready  ## count false alarms over 1,000 experiments that converge, and detections (minutes)
	@$(BIN)/python tests/benchmarks/watch.py

peers: $(BIN)/ready  ## our default against PD, least squares and norm-optimal, on plants that are off (minutes)
	@$(BIN)/python tests/benchmarks/peers.py

study: $(BIN)/ready  ## 10,000 rods that are off: make study [SCHEDULER=address]; results in build/study
	@$(BIN)/python tests/benchmarks/study.py $(SCHEDULER)

pages: $(BIN)/ready  ## the notebooks, the ledger and the reference as HTML, in build/pages
	@rm -rf build/pages
	@$(BIN)/sphinx-build -q -c docs -d build/doctrees . build/pages
	@echo "open build/pages/index.html"

bench: $(BIN)/ready  ## time the synthesis and a study; rewrite figures/performance.*
	@mkdir -p build
	$(BIN)/pytest -q tests/benchmarks/bench_*.py --benchmark-json=build/benchmark.json \
		--benchmark-columns=median,min,max,rounds
	$(BIN)/python tests/benchmarks/report.py build/benchmark.json

# Jupyter refuses to run as root, except in a container, where root is whoever started it.
lab: LAB := $(if $(wildcard /.dockerenv /run/.containerenv),--allow-root)
lab: $(BIN)/ready  ## JupyterLab, at the workbench first (as root: make lab LAB=--allow-root)
	$(BIN)/jupyter lab $(LAB) --notebook-dir=notebooks --LabApp.default_url=/lab/tree/12-workbench.ipynb \
		--LabApp.app_settings_dir=notebooks/.jupyterlab  # where notebooks are saved on request only

notebooks: $(BIN)/ready  ## execute the tracked notebooks in place, before a commit
	$(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--ExecutePreprocessor.record_timing=False $(NOTEBOOKS)

stubs: $(BIN)/ready  ## write rodlib/*.pyi, which editors read, from the registry of doors
	$(BIN)/python tests/stubs.py

lock: WRITTEN := --universal --generate-hashes --no-emit-index-url --no-emit-find-links \
	--custom-compile-command "make lock" --quiet
lock: $(BIN)/ready  ## resolve the dependencies anew: writes environment.lock and what Binder installs
	$(BIN)/uv pip compile pyproject.toml --extra dev --fork-strategy fewest --upgrade $(WRITTEN) \
		--output-file environment.lock
	$(BIN)/uv pip compile pyproject.toml --extra notebooks --extra approximations --extra tclab \
		--python-version 3.12 --constraint environment.lock $(WRITTEN) \
		--output-file binder/requirements.txt

clean:  ## remove build/ and the environment
	rm -rf build mutants .venv

$(BIN)/ready:  # phony: environment.py knows whether there is something to do
	@$(PYTHON) environment.py
