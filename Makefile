# make demo       map and tracks of the bundled sample video, and what may happen there
# make notebook   the notebooks, in JupyterLab; elsewhere: make notebook LAB="--no-browser --port 8888"
# make test       lint, format, types, layers, and the tests, in a few minutes
# make test-slow  what takes longer, shapes checked: kills, damage, benchmarks, documentation, notebooks
# make check      lint, types and the tests of changed files, in a minute, before a commit
# make test-lowest   the package's tests with the lowest versions that pyproject.toml allows
# make lint       ruff, mypy and import-linter alone
# make docs       the documentation, in build/site
# make bench      lists what measures the library: python -m benchmarks.NAME
# make coverage   the tests again, with the share of lines that they run
# Needs python 3.11 or newer with venv; another one: make test PYTHON=python3.12
# On Windows: in a bash shell, with PYTHON=python

PYTHON ?= python3
ifeq ($(OS),Windows_NT)
SHELL := bash
BIN := .venv/Scripts
else
BIN := .venv/bin
endif
LOWEST_BIN := $(subst .venv,.venv-lowest,$(BIN))
SAMPLE ?= samples/hover.mp4
POINTS ?= samples/gcps.csv
# PyPI's torch for Linux brings several GB of CUDA, which only a GPU of NVIDIA uses;
# with CPU_TORCH= it is installed all the same
CPU_TORCH ?= $(shell test "$$(uname -s)" = Linux && ! command -v nvidia-smi >/dev/null && echo yes)
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
# functions of array code refuse arguments of other shapes or types than their signatures say
SHAPES := --jaxtyping-packages=geoaim,benchmarks,tests.check_types
NOTEBOOKS := $(wildcard notebooks/*.ipynb)
QUICK_NOTEBOOKS := $(wildcard notebooks/03_*.ipynb notebooks/05_*.ipynb)

export PIP_DISABLE_PIP_VERSION_CHECK = 1
export NO_MKDOCS_2_WARNING = 1
unexport PYTHONDONTWRITEBYTECODE  # processes of tests would compile all again

.PHONY: bench demo notebook test test-slow test-lowest check tests changed lint ruff mypy layers docs coverage install clean

demo: .venv/usable
	rm -rf demo/junction
	$(BIN)/geoaim place $(SAMPLE) --points $(POINTS) -o demo/junction
	$(BIN)/geoaim predict demo/junction --hdmap samples/map.osm -o demo/futures.png
	$(BIN)/geoaim render demo/junction/map.tif --tracks samples/tracks.csv --ego 9 --size 384 --trail 2 \
		--lights samples/lights.csv --hdmap samples/map.osm -o demo/view.gif
	@echo
	@echo "Open demo/junction/map.tif   the map, in QGIS or any other GIS program"
	@echo "     demo/junction/map.png   a quick look: background, control points, drift, coverage"
	@echo "     demo/junction/film.mp4  the vehicles that were found, on the video and on the map"
	@echo "     demo/futures.png        what they may do in the next four seconds"
	@echo "     demo/view.gif           the view of one car of the recorded traffic"
	@echo
	@echo "Go on with:"
	@echo "     source $(BIN)/activate"
	@echo "     geoaim view demo/junction"
	@echo "     make notebook"

notebook: .venv/jupyterlab
	$(BIN)/python -m jupyterlab notebooks $(if $(filter 0,$(shell id -u 2>/dev/null)),--allow-root) $(LAB)

# there is a worker for each core already
tests changed test-slow test-lowest coverage: export OMP_NUM_THREADS = 1
# tests that fail run once more, one by one: what fails by the machine's load alone fails no run
define run_tests
$(BIN)/python -m pytest --cache-clear $(1) || { [ $$? -eq 1 ] && \
	$(BIN)/python -m pytest $(1) -n 0 --last-failed --last-failed-no-failures none; }
endef

# a lint that waits for one core leaves the others to the tests
test: install
	$(MAKE) --no-print-directory -j 2 lint tests

tests: install
	$(call run_tests,-n auto --dist loadfile --durations 30 -m "not slow and not benchmarks" \
		geoaim tests $(if $(QUICK_NOTEBOOKS),--nbmake $(QUICK_NOTEBOOKS)))

test-slow: install
	$(call run_tests,-n auto --dist loadfile -m "slow or hypothesis or benchmarks" \
		--hypothesis-profile many $(SHAPES))
	$(if $(NOTEBOOKS),$(call run_tests,-n auto -o addopts= --nbmake \
		$(filter-out $(QUICK_NOTEBOOKS),$(NOTEBOOKS))))

check: install
	$(MAKE) --no-print-directory -j 2 lint changed

changed: install
	$(BIN)/python tests/changed.py -n auto --dist loadfile -m "not slow" $(SHAPES)

# old versions beside new ones warn; the documentation and the layers need tools of their own
test-lowest: .venv-lowest/installed
	$(LOWEST_BIN)/python -m pytest -n auto --dist loadfile -o filterwarnings=default \
		--disable-warnings --doctest-ignore-import-errors --ignore tests/test_docs.py --ignore tests/test_architecture.py $(TESTS)

coverage: install
	$(BIN)/python -m pytest -n auto --dist loadfile $(SHAPES) --cov=geoaim \
		--cov-report=term:skip-covered --cov-report=xml:build/coverage.xml

lint: ruff mypy layers

ruff: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

mypy: install
	$(BIN)/mypy

layers: install
	$(BIN)/lint-imports

bench: install
	$(BIN)/python -m benchmarks

docs: install
	$(BIN)/python -m mkdocs build --strict
	@echo "Open build/site/index.html"

install: .venv/installed

# what users need, made again when the dependencies change; tests and notebooks add to it;
# modules are compiled when they are first imported
.venv/usable: pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'geoaim needs Python 3.11 or newer, found ' + sys.version.split()[0] + '; name another one: make PYTHON=python3.12')"
	@echo "Installing geoaim and the packages that it needs into .venv: about 2 GB, most of it torch (for a GPU of NVIDIA several more)"
	$(PYTHON) -m venv --clear .venv
	$(if $(CPU_TORCH),$(BIN)/python -m pip install --no-compile --no-deps --retries 1 \
		--constraint constraints.txt --index-url $(TORCH_INDEX) torch \
		|| echo "$(TORCH_INDEX) has no torch for this machine: taking the one of PyPI")
	$(BIN)/python -m pip install --no-compile --constraint constraints.txt --editable '.[jupyter]'
	touch $@

.venv/installed: .venv/usable
	@echo "Adding the tools of tests and documentation to .venv"
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[test]'
	touch $@

.venv/jupyterlab: .venv/usable
	@echo "Adding JupyterLab to .venv"
	$(BIN)/python -m pip install --quiet --constraint constraints.txt jupyterlab
	touch $@

.venv-lowest/installed: pyproject.toml constraints-lowest.txt
	$(PYTHON) -m venv --clear .venv-lowest
	$(LOWEST_BIN)/python -m pip install --quiet --constraint constraints-lowest.txt --editable . \
		beartype hypothesis jsonschema pytest pytest-xdist
	touch $@

clean:
	rm -rf .venv .venv-lowest demo build dist *.egg-info .coverage .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
