# make demo | test | coverage | test-slow | test-gpu | bench-gpu | sanitize-gpu | fuzz | lint | docs | native | clean
# Tests run against the installed package, so every target that runs something installs it first when a source changed.
PYTHON ?= python3
VENV ?= .venv
PHOTO ?= samples/chelsea.png
DRAWING ?= samples/logo.png
DEMO_OPTIONS ?=
PYTEST_OPTIONS ?=
TESTS ?= tests
# Processes that compile, and that run tests: JOBS=0 runs them in one, with its output as it comes.
JOBS ?= 2
FUZZ_INPUTS ?= 100000

ifeq ($(OS),Windows_NT)
BIN := $(VENV)/Scripts
else
BIN := $(VENV)/bin
endif
PY := $(BIN)/python
CONSTRAINTS ?= constraints.txt
PIP_INSTALL := $(PY) -m pip install --quiet --disable-pip-version-check $(if $(CONSTRAINTS),-c $(CONSTRAINTS))
# The package is built in a folder that is kept, by tools that stay where they are: an edited kernel is all that is
# compiled again. In pip's own isolation they would lie elsewhere each time, and CMake would begin anew.
INSTALL_PACKAGE := $(PIP_INSTALL) --no-build-isolation --config-settings=build-dir=build/wheel
BUILD_TOOLS := "scikit-build-core>=1.1" $(foreach tool,cmake ninja,$(if $(shell command -v $(tool)),,$(tool)))
# The GPU's targets have an environment of their own: with the torch that $(PYTHON) has, which on a GPU machine is often
# one with CUDA, else with the newest torch there is. The pinned one may be a build for the CPU.
GPU_VENV ?= .venv-gpu
WITH_GPU := $(MAKE) --no-print-directory VENV=$(GPU_VENV) VENV_OPTIONS=--system-site-packages CONSTRAINTS=
# Pytest keeps the tests as it has rewritten them, also where the environment has Python keep nothing: to rewrite them
# takes longer than to import them.
export PYTHONDONTWRITEBYTECODE :=
# The fast tests, shared out among processes; one that has run out takes over some of another's. At the end stand those
# that took longest.
FAST_TESTS := $(PY) -m pytest -m "not slow and not gpu" --timeout 300 --durations 25 -n $(JOBS) --dist worksteal
# Without a GPU every one of these tests would be skipped, which must not look like success.
GPU_OR_WHY := $(PY) -c "import sys; from cubicsplat_cli.raster.cuda.driver import missing_piece; sys.exit(missing_piece())"

# Folders are in the list so that a removed or renamed file counts as a change too.
SOURCES := pyproject.toml CMakeLists.txt README.md $(shell find src \
	\( -name __pycache__ -o -name '_cubicsplat.*' \) -prune -o \( -type f -o -type d \) -print)
# C++ and CUDA, the tests' own included.
KERNELS := $(shell find src tests \( -name '*.cpp' -o -name '*.h' -o -name '*.cu' -o -name '*.cuh' \) -print)
VENV_STAMP := $(VENV)/.stamp-created
BUILD_STAMP := $(VENV)/.stamp-build
PACKAGE_STAMP := $(VENV)/.stamp-package
TEST_STAMP := $(VENV)/.stamp-test

.NOTPARALLEL:
.PHONY: demo test coverage test-slow test-gpu bench-gpu sanitize-gpu fuzz lint docs native clean install
.PHONY: run-test-gpu run-bench-gpu run-sanitize-gpu
.DEFAULT_GOAL := demo

demo: $(PACKAGE_STAMP)
	$(BIN)/cubicsplat vectorize $(PHOTO) $(DRAWING) -o build/demo/ --report --force $(DEMO_OPTIONS)
	@echo "Open this in a browser: $(CURDIR)/build/demo/index.html"

install: $(PACKAGE_STAMP)

test: $(TEST_STAMP)
	$(FAST_TESTS) $(PYTEST_OPTIONS) $(TESTS)

# The same tests with the line coverage of the Python code, the command's own processes included.
coverage: $(TEST_STAMP)
	$(FAST_TESTS) --cov --cov-report=term $(PYTEST_OPTIONS) $(TESTS)

test-slow: $(TEST_STAMP)
	$(PY) -m pytest -m "slow and not gpu" --timeout 3600 $(PYTEST_OPTIONS) $(TESTS)

# Parity with the reference and the CPU, graphs, waiting, memory, and whole fits on the GPU.
test-gpu:
	$(WITH_GPU) run-test-gpu
run-test-gpu: $(TEST_STAMP)
	@$(GPU_OR_WHY)
	$(PY) -m pytest -m gpu --timeout 1200 $(PYTEST_OPTIONS) $(TESTS)

# Times and memory on the GPU against the stated targets (docs/cuda.md): steps, a fit, the whole command.
bench-gpu:
	$(WITH_GPU) run-bench-gpu
run-bench-gpu: $(PACKAGE_STAMP)
	$(PY) tools/bench_gpu.py

# The parity suite under NVIDIA's checkers, which come with the CUDA toolkit: accesses out of bounds, races in shared
# memory, barriers that not all threads reach, reads of memory that nobody has written.
SANITIZE = compute-sanitizer --error-exitcode 1
FEW_ON_GPU = $(PY) -m pytest -m gpu -q tests/test_engine.py -k "match or steps_are"
sanitize-gpu:
	$(WITH_GPU) run-sanitize-gpu
run-sanitize-gpu: $(TEST_STAMP)
	@$(GPU_OR_WHY)
	$(SANITIZE) --tool memcheck $(PY) -m pytest -m gpu -q tests/test_engine.py
	$(SANITIZE) --tool racecheck $(FEW_ON_GPU)
	$(SANITIZE) --tool synccheck $(FEW_ON_GPU)
	$(SANITIZE) --tool initcheck $(FEW_ON_GPU)

# What reads files of others, with damaged ones: no crash, no hang, no traceback. Finds are kept in tests/fuzz.
fuzz: $(TEST_STAMP)
	$(PY) tools/fuzz.py --inputs $(FUZZ_INPUTS)

# Rules, layout, and types: the last with the packages that the types come from.
lint: $(BIN)/ruff $(BIN)/mypy $(BIN)/clang-format $(PACKAGE_STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(KERNELS)
	$(BIN)/mypy

# The pages, with the gallery of the samples; a broken link fails.
docs: $(BIN)/mkdocs $(PACKAGE_STAMP)
	$(PY) tools/gallery.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "Open this in a browser: $(CURDIR)/build/site/index.html"

# For work on the C++ alone: a quick incremental build next to the sources, for PYTHONPATH=src. Nothing else uses it.
native:
	cmake -S . -B build/native -DCMAKE_BUILD_TYPE=Release
	cmake --build build/native --parallel $(JOBS)
	cmake --install build/native --component engine --prefix build/native/install
	# Remove first: writing into a library that a running process has mapped would crash that process.
	rm -f src/cubicsplat_cli/raster/_cubicsplat.*
	cp build/native/install/cubicsplat_cli/raster/_cubicsplat.* src/cubicsplat_cli/raster/

$(VENV_STAMP):
	test -x $(PY) || $(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	@touch $@

$(BUILD_STAMP): constraints.txt $(VENV_STAMP)
	$(PIP_INSTALL) $(BUILD_TOOLS)
	@touch $@

$(PACKAGE_STAMP): $(SOURCES) constraints.txt $(BUILD_STAMP)
	$(INSTALL_PACKAGE) .
	@touch $@

$(TEST_STAMP): $(SOURCES) constraints.txt $(BUILD_STAMP)
	$(INSTALL_PACKAGE) ".[test]"
	@touch $(PACKAGE_STAMP) $@

$(BIN)/ruff $(BIN)/mypy $(BIN)/clang-format: $(VENV_STAMP) constraints.txt
	$(PIP_INSTALL) --upgrade $(@F)
	@touch $@

$(BIN)/mkdocs: $(VENV_STAMP) constraints.txt
	$(PIP_INSTALL) --upgrade mkdocs-material
	@touch $@

clean:
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis
	rm -f src/cubicsplat_cli/raster/_cubicsplat.* $(BUILD_STAMP) $(PACKAGE_STAMP) $(TEST_STAMP)
