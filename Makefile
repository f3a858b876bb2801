# The two commands of this compendium: make reproduce, make test. `make help` lists the rest.

PYTHON ?= python3
BIN := .venv/bin
# One of each function that is long enough, some 300 in all.
MUTANTS := "*__mutmut_29"
PROJECTS := pyproject.toml toolbox/pyproject.toml
NOTEBOOKS := $(wildcard notebooks/*.ipynb)
# Whatever the caller's environment says, figures and output are the same: its settings of Python
# and Jupyter do not count. Notebooks run side by side: one thread of linear algebra each.
unexport $(filter PYTHON% IPYTHON% JUPYTER% JPY% PYTEST% RODLIB% CONDA% VIRTUAL_ENV%,$(.VARIABLES))
unexport PIP_TARGET PIP_PREFIX PIP_ROOT PIP_USER PIP_DRY_RUN UV_DRY_RUN
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
.PHONY: $(BIN)/ready help reproduce test article lint data machines mutants lowest newest measure pages bench \
	lab notebooks stubs lock clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

reproduce: $(BIN)/ready  ## run all notebooks; regenerate figures/ and the ledger
	@$(BIN)/python -m rodlib.paper.reproduce

test: $(BIN)/ready  ## lint, unit tests, the committed notebooks against a fresh run, a browser
	@$(BIN)/python tools/suite.py

article: $(BIN)/ready  ## the report of the reproduction, article/article.pdf, from the ledger
	@$(BIN)/python -m rodlib.paper.article

lint: $(BIN)/ready  ## ruff on modules, tests and notebooks; how much there is to read
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python tools/rooms.py

data: $(BIN)/ready  ## record the logs of the virtual rig in data/rig anew
	$(BIN)/python -m rodlib.paper.rig_logs

machines: $(BIN)/ready  ## make test with the kernels of another processor: make machines SEED=2
	$(BIN)/python tools/machines.py $(SEED)

mutants: $(BIN)/ready  ## change one thing at a time in rodlib, then in ilctools; list what no test notices (long)
	for room in . toolbox; do cd $(CURDIR)/$$room && $(CURDIR)/$(BIN)/mutmut run $(MUTANTS); \
		$(CURDIR)/$(BIN)/mutmut results | grep -v "not checked"; done

lowest: $(BIN)/ready  ## unit tests with the oldest packages that pyproject.toml admits
	@mkdir -p build
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip compile --quiet $(PROJECTS) --resolution lowest-direct --no-emit-index-url \
		--output-file build/lowest.txt
	$(BIN)/uv pip install --quiet --python build/lowest --constraints build/lowest.txt \
		-e ./toolbox -e ".[dev]"
	build/lowest/bin/pytest -q -W ignore::DeprecationWarning -W ignore::FutureWarning

newest: $(BIN)/ready  ## unit tests with the newest packages that pyproject.toml admits, not the lock's
	@mkdir -p build
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/newest
	$(BIN)/uv pip install --quiet --upgrade --python build/newest -e ./toolbox -e ".[dev]"
	build/newest/bin/pytest -q

measure: $(BIN)/ready  ## what takes minutes to an hour: make measure WHAT=regions; alone, it lists what there is
	@grep -qs __main__ "benchmarks/$(WHAT).py" || { \
		test -z "$(WHAT)" || echo "WHAT=$(WHAT) is not there; these are:" >&2; \
		grep -l __main__ benchmarks/*.py | xargs grep -m 1 '^"""' \
		| sed 's|benchmarks/\(.*\).py:"""|make measure WHAT=\1\t|' | expand -t 40; exit 2; }
	@PYTHONPATH=toolbox/tests $(BIN)/python benchmarks/$(WHAT).py $(ARGS)

pages: $(BIN)/ready  ## the notebooks, the ledger and the reference as HTML, in build/pages
	@rm -rf build/pages
	@$(BIN)/sphinx-build -q -c docs -d build/doctrees . build/pages
	@echo "open build/pages/index.html"

bench: $(BIN)/ready  ## time the synthesis against CVXPY; rewrite its table in figures/performance.md
	@PYTHONPATH=toolbox/tests $(BIN)/python benchmarks/bench_synthesis.py

# Jupyter refuses to run as root, except in a container, where root is whoever started it.
lab: LAB := $(if $(wildcard /.dockerenv /run/.containerenv),--allow-root)
lab: $(BIN)/ready  ## JupyterLab, at notebook 0 (as root: make lab LAB=--allow-root)
	$(BIN)/jupyter lab $(LAB) --notebook-dir=notebooks --LabApp.default_url=/lab/tree/00-first-trial.ipynb \
		--LabApp.app_settings_dir=notebooks/.jupyterlab  # where notebooks are saved on request only

notebooks: $(BIN)/ready  ## execute the tracked notebooks in place, before a commit
	TQDM_DISABLE=1 $(BIN)/jupyter nbconvert --to notebook --execute --inplace \
		--ExecutePreprocessor.record_timing=False $(NOTEBOOKS)

stubs: $(BIN)/ready  ## write the packages' stubs, which editors read, from their registries
	$(BIN)/python tools/stubs.py

lock: WRITTEN := --universal --generate-hashes --no-emit-index-url --no-emit-find-links \
	--custom-compile-command "make lock" --quiet
lock: $(BIN)/ready  ## resolve the dependencies anew: writes environment.lock and what Binder installs
	$(BIN)/uv pip compile $(PROJECTS) --extra dev --fork-strategy fewest --upgrade $(WRITTEN) \
		--output-file environment.lock
	$(BIN)/uv pip compile $(PROJECTS) --extra notebooks --extra approximations --extra tclab \
		--python-version 3.12 --constraint environment.lock $(WRITTEN) \
		--output-file binder/requirements.txt

clean:  ## remove build/ and the environment
	rm -rf build mutants .venv

$(BIN)/ready:  # phony: environment.py knows whether there is something to do
	@$(PYTHON) environment.py
