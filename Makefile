# Two commands for a newcomer: `make demo` and `make test`. Each sets itself up from the lock file.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out
JOBS ?= 2
BIN = $(VENV)/bin
# one BLAS thread each: the work is parallel over processes, and threads on small matrices only cost
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1
# hundreds of processes of the tests read the package compiled, also where the caller compiles each time
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test docs lock clean

$(VENV)/core: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

$(VENV)/test: $(VENV)/core requirements-test.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-test.lock
	touch $@

demo: $(VENV)/core
	$(BIN)/probupdate demo $(OUT)

# MARK chooses tests by their markers, as pytest's -m; files with few long tests are not left to the end
MARK ?= not long
test: $(VENV)/test
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "$(MARK)"

$(VENV)/docs: $(VENV)/core requirements-docs.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	touch $@

# the site, into site/; it needs no network once it is set up, and opens and is searched from disk
docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/docs
	$(BIN)/python -m mkdocs build --quiet --strict

# the locks name no index; run this with uv at hand after a change of pyproject.toml
lock:
	uv lock
	uv export --frozen --no-emit-project --quiet -o requirements.lock
	uv export --frozen --no-emit-project --quiet --extra test --extra peers --extra parquet --extra zarr --extra dask --extra uff --extra tdms --extra mdf\
	  --extra miniseed --extra nastran -o requirements-test.lock
	rm uv.lock
	sed -i '1,2d' requirements.lock requirements-test.lock
	$(BIN)/python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']\
	['optional-dependencies']['docs'], sep='\n')" | uv pip compile - -c requirements.lock --universal \
	--python-version 3.11 --generate-hashes --no-header --no-annotate --quiet -o requirements-docs.lock
	! grep -n http requirements.lock requirements-test.lock requirements-docs.lock

clean:
	rm -rf $(VENV) build site *.egg-info
