# Gibson Sim: every target sets up what it needs first. PYTHON and VENV choose another interpreter and another environment.
PYTHON ?= python3
VENV ?= .venv
ARGS ?=
PYTEST_ARGS ?=

BIN := $(VENV)/bin
CODE := bootstrap.py build_wheels.py src/gibson_sim src/gibson_sim_bench src/gibson_sim_learn src/gibson_sim_tools ros_ws/src/gibson_examples ros_ws/src/gibson_path_following docs tests

export FASTRTPS_DEFAULT_PROFILES_FILE ?= $(CURDIR)/config/fastdds.xml
# Keeps another ROS installation or environment out of ours.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

.PHONY: help setup run check test quick fuzz lint format bench wheels clean
.DEFAULT_GOAL := help

help:
	@echo 'make setup              make the environment $(VENV); PYTHON=python3.12 chooses the interpreter (3.10 to 3.13)'
	@echo 'make run ARGS="..."     set up, then gibson-sim run ...'
	@echo 'make test               set up, then all tests; PYTEST_ARGS="-k name" chooses some'
	@echo 'make quick              set up, then the tests of the core that need neither processes nor engines: a minute'
	@echo 'make check              what a change must pass: lint, then all tests; none skipped for what this machine has'
	@echo 'make fuzz ARGS="..."    set up, then hostile inputs for a minute; ARGS="--seconds 3600" for an hour, --help for more'
	@echo 'make lint               set up, then ruff, mypy and the import rules'
	@echo 'make format             set up, then let ruff format the code'
	@echo 'make bench              set up, then a short table of speeds beside that of docs/benchmarks; for information'
	@echo 'make wheels             set up, then build the wheels that pip installs, in out/wheels; publishes nothing'
	@echo 'make clean              remove $(VENV) and all build outputs'

# With this variable, each of the thousands of processes of the tests would compile all modules that it imports: 2 s for a node.
unexport PYTHONDONTWRITEBYTECODE

setup:
	@$(PYTHON) bootstrap.py --venv '$(VENV)'

run: setup
	@'$(BIN)/gibson-sim' run $(ARGS)

# The first run takes the files in their order, physics and pictures before the unit tests: by number of tests, as is usual, long files of few
# tests would come last, and one of them would run alone. Tests that start nodes as processes mostly wait: for time that passes, for nodes that
# find each other. So two files of them run at a time, each in a ROS domain of its own. A failed test gets a second attempt; a first failure is
# printed at the end as FLAKY and needs a fix all the same. The failures of both runs are the last lines of the output. Each process runs linear
# algebra in one thread: several processes with as many threads as cores wait for each other, which doubles the time of some tests.
NODES := tests/ros tests/acceptance
FAILURES := .pytest_cache/failures

ifeq ($(strip $(PYTEST_ARGS)),)
test: setup
	@code=0; rm -f $(FAILURES); mkdir -p $(dir $(FAILURES)); export GIBSON_SIM_TEST_FAILURES='$(CURDIR)/$(FAILURES)' OPENBLAS_NUM_THREADS=1; \
	'$(BIN)/python' -m pytest -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder $(NODES:%=--ignore=%) || code=$$?; \
	'$(BIN)/python' -m pytest -n auto --maxprocesses 2 --dist loadfile --reruns 1 --durations 20 $(NODES) || code=$$?; \
	cat $(FAILURES) 2>/dev/null; exit $$code
else
test: setup
	@'$(BIN)/python' -m pytest $(PYTEST_ARGS)
endif

# For a change in the core, while you work on it: docs/testing.md says what it leaves out.
QUICK_WITHOUT := agents bags bench cli examples jobs learn path_following processes testing tools trials

quick: setup
	@OPENBLAS_NUM_THREADS=1 '$(BIN)/python' -m pytest -q -n auto --maxprocesses 4 --dist loadfile -m 'not shipped' tests/conformance tests/unit $(QUICK_WITHOUT:%=--ignore=tests/unit/%) $(PYTEST_ARGS)

# The page is tested in a real browser: as root the check installs one, elsewhere its tests say what is missing.
check: lint
	@if ! command -v chromium >/dev/null && command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ]; then \
	  apt-get -qq update && apt-get -qq install -y --no-install-recommends chromium >/dev/null || echo 'no Chromium could be installed'; fi
	@GIBSON_SIM_STRICT=1 $(MAKE) test

fuzz: setup
	@PYTHONPATH=tests '$(BIN)/python' -m fuzz $(ARGS)

lint: setup
	@'$(BIN)/ruff' check $(CODE)
	@'$(BIN)/ruff' format --check $(CODE)
	@'$(BIN)/mypy' --native-parser --num-workers 2
	@'$(BIN)/lint-imports'

format: setup
	@'$(BIN)/ruff' check --fix $(CODE)
	@'$(BIN)/ruff' format $(CODE)

# For information: speeds differ between machines and from hour to hour. A slow result never fails.
BENCH_BEFORE ?= docs/benchmarks/table1_cpu.json

bench: setup
	@'$(BIN)/gibson-sim' bench table1 --quick --only 'in process' --json out/table1.json
	@if [ -f '$(BENCH_BEFORE)' ]; then '$(BIN)/gibson-sim' bench compare '$(BENCH_BEFORE)' out/table1.json; fi

wheels: setup
	@'$(BIN)/python' build_wheels.py --output out/wheels

clean:
	rm -rf '$(VENV)' ros_ws/build ros_ws/install ros_ws/log src/*/build src/*/*.egg-info
	rm -rf ros_ws/src/gibson_*/build ros_ws/src/gibson_*/*.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src ros_ws/src/gibson_examples ros_ws/src/gibson_path_following tests -name __pycache__ -type d -prune -exec rm -rf {} +
