# Two commands on a fresh machine: `make demo` and `make test`. Both make .venv themselves.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WARM := $(VENV)/.warm
DOCS_READY := $(VENV)/.docs
RELEASE_READY := $(VENV)/.release

# Scripts of the paper's figures and tables; what is finished is taken as it is. ARGS=--quick is a coarse look at all.
FIGURES := fig05_response fig08_09_field fig10_board fig11_edge fig12_transition fig13_oriented \
	table1_ambient table3_focal_length table3_reason table4_lenth
NUMBERED := fig05 fig08 fig09 fig10 fig11 fig12 fig13 table1 table3 table3_reason table4

.PHONY: demo face docs test test-long test-hid test-report test-face test-docs test-wheel coverage lint bench bias invariance crosscheck validate figures replication $(NUMBERED) povray chromium node packages lock clean help

help:
	@echo "make demo   set up, render the calibration board, say where the picture lies"
	@echo "make face   set up, and turn the light of the calibration board in the browser"
	@echo "make docs   build the site of the documentation, out/docs/index.html; it runs the tutorials and renders every scene"
	@echo "make test   set up (POV-Ray by apt where missing), lint, run the tests"
	@echo "make test-long  the whole samples of slow statistics, of which make test takes a part"
	@echo "make test-hid  the LED cases on real HID devices, in two virtual machines (qemu by apt where missing)"
	@echo "make test-report  open the report of a study in a real browser (Chromium by apt where missing)"
	@echo "make test-face  check the types of the page's modules, and turn its knobs in a real browser (apt, npm)"
	@echo "make test-docs  look at every page of the site in a real browser (make docs before; apt, npm)"
	@echo "make test-wheel  the first tutorials from the wheel, in empty environments for each Python that is there"
	@echo "make packages  wheel and sdist into out/dist, built twice and compared; workflow files against their schema"
	@echo "make lock   write the lock files anew from pyproject.toml, versions as they are where they fit"
	@echo "make coverage  lines and branches that the tests run, in all processes"
	@echo "make lint   ruff, codespell and mypy --strict"
	@echo "make bench  speed, overhead, memory, what a tolerance costs, and real cells beside Mitsuba (ARGS: bench_cells.py)"
	@echo "make crosscheck   Radiance against POV-Ray on rad_scenes/crosscheck"
	@echo "make figures       figures and tables of the paper, ours beside the printed, into out/figures (ARGS=--quick)"
	@echo "make fig12, make table3, ...   one of them"
	@echo "make replication   the same, and one page of all verdicts, out/replication/index.html"
	@echo "make validate    the score card of closed forms, with plots in out/validate/index.html"
	@echo "make invariance   random scenes, rewritten so that their image must stay (an hour and more)"
	@echo "make bias   bias of algorithms on predicted images, with plots"

demo: $(WARM)
	@$(BIN)/radwrap render rad_scenes/bench_board/scene.toml --out out/demo
	@echo "The picture is out/demo/gray.png"

face: $(WARM)
	@$(BIN)/radwrap face rad_scenes/bench_board/scene.toml $(ARGS)

# No network: what pages show stands beside them. A warning is an error.
docs: $(DOCS_READY) $(WARM)
	@$(BIN)/python -m sphinx -W --keep-going -q -b html -d out/docs_tree docs out/docs
	@echo "The site is out/docs/index.html"

# Three processes, as the machine that the suite is timed on has two cores, and tests that kill or time something wait
# for a sixth of the time; tests of a file share what they make, and the longest files are begun first (conftest.py).
# One thread each for linear algebra: on small matrices more threads mostly wait for each other, at five times the cost.
# And glibc keeps what it has: arrays of some megabytes would be mapped and cleared anew each time.
ONE_THREAD := OPENBLAS_NUM_THREADS=1 MALLOC_TRIM_THRESHOLD_=1073741824 MALLOC_MMAP_THRESHOLD_=268435456
PYTEST := -m pytest -n 3 --dist loadfile --no-loadscope-reorder --durations=20
# Plain asserts load in half the time, in each process; what fails is run again by asserts that show their values.
tested = $(ONE_THREAD) $(BIN)/python $(PYTEST) --assert=plain $(1) || \
	{ $(ONE_THREAD) $(BIN)/python $(PYTEST) --last-failed --last-failed-no-failures none $(1); exit 1; }

test: $(WARM) povray lint
	@command -v node >/dev/null 2>&1 || echo "note: there is no node: the page's own modules are not tested; on Debian: apt install nodejs"
	@$(call tested,)

# The whole samples of slow statistics, of which make test takes a part.
test-long: $(WARM)
	@$(call tested,-m long)

test-hid: $(WARM)
	@$(BIN)/python scripts/test_hid.py

test-report: $(WARM) chromium
	@$(BIN)/python -m pytest tests/study/report_in_browser.py

# Ten minutes at most. What is missing is installed by apt and npm; where that fails the tests fail.
FACE := tests/face/browser
test-face: $(WARM) chromium node
	@cd $(FACE) && npm ci --no-audit --no-fund --silent && npx tsc -p tsconfig.json
	@timeout 600 node --test $(FACE)/face.test.mjs

test-docs: docs chromium node
	@cd $(FACE) && npm ci --no-audit --no-fund --silent
	@node tests/docs_site/site.mjs out/docs

# ARGS are pytest's: a folder of tests, say.
coverage: $(WARM) povray
	@$(BIN)/coverage erase
	@$(ONE_THREAD) $(BIN)/coverage run $(PYTEST) $(ARGS); code=$$?; \
		$(BIN)/coverage combine --quiet && $(BIN)/coverage report --skip-covered --skip-empty && exit $$code

lint: $(READY)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/codespell
	@$(BIN)/mypy

bench: $(WARM)
	@$(BIN)/python scripts/bench_cells.py $(ARGS)
	@$(BIN)/python scripts/bench.py; first=$$?; $(BIN)/python scripts/bench_tolerance.py && exit $$first

bias: $(WARM)
	@$(BIN)/python scripts/bias_studies.py

invariance: $(WARM)
	@$(BIN)/python scripts/invariance.py $(ARGS)

crosscheck: $(WARM) povray
	@$(BIN)/python scripts/crosscheck.py

figures: $(WARM)
	@$(BIN)/python scripts/replicate.py --figures-only $(ARGS)

replication: $(WARM)
	@$(BIN)/python scripts/replicate.py $(ARGS)

fig08 fig09: NAME := fig08_09
$(NUMBERED): $(WARM)
	@$(BIN)/python scripts/$(firstword $(filter $(or $(NAME),$@)_%,$(FIGURES)) $@).py $(ARGS)

validate: $(WARM)
	@$(BIN)/radwrap validate --out out/validate

# Files whose hashes are not in the lock file are not installed.
LOCKED := -m pip install --quiet --disable-pip-version-check --require-hashes

# A changed lock file or project file sets the environment up again; otherwise this is done at once.
$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "error: Python 3.11 or newer is needed; on Debian: apt install python3, or name one with PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
		{ echo "error: Python's venv module is missing; on Debian: apt install python3-venv"; exit 1; }
	@echo "setting up $(VENV) ..."
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python $(LOCKED) -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(BIN)/python -m compileall -q radwrap scripts tests  # a command starts in 0.15 s less, also where Python may not write byte code
	@touch $(READY)

# Compiles our own tracer, some 30 s, once for each of its versions.
$(WARM): $(READY) $(wildcard radwrap/tracers/compiled/*.py)
	@$(BIN)/radwrap doctor --warm >/dev/null
	@touch $(WARM)

$(DOCS_READY): requirements-docs.lock $(READY)
	@$(BIN)/python $(LOCKED) -r requirements-docs.lock
	@touch $(DOCS_READY)

$(RELEASE_READY): requirements-release.lock $(READY)
	@$(BIN)/python $(LOCKED) -r requirements-release.lock
	@touch $(RELEASE_READY)

# Builds wheel and sdist twice and compares them, says what an index and the forge would say; uploads nothing.
packages: $(RELEASE_READY)
	@$(BIN)/python scripts/packages.py
	@$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml

# What the ranges of pyproject.toml bring, for Python 3.11 and newer at once. Versions stay as they are where they fit:
# ARGS="--upgrade-package numpy" takes the newest of one. The three files agree, as one environment may have them all.
COMPILED := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --custom-compile-command "make lock" --no-annotate
lock: $(RELEASE_READY)
	@$(COMPILED) pyproject.toml --extra dev -o requirements.lock $(ARGS) >/dev/null
	@$(COMPILED) --group docs -c requirements.lock -o requirements-docs.lock $(ARGS) >/dev/null
	@$(COMPILED) --group release -c requirements.lock -c requirements-docs.lock -o requirements-release.lock $(ARGS) >/dev/null

# Tutorials from the wheel in empty environments, for each Python from 3.11 on that is there (ARGS names others).
test-wheel: $(READY)
	@$(BIN)/python scripts/test_wheel.py $(ARGS)

# POV-Ray is for cross-checks alone; where there is no apt, tests that need it say so.
povray:
	@command -v povray >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1 || { \
		SUDO=; [ "$$(id -u)" = 0 ] || SUDO=sudo; \
		echo "installing POV-Ray ..."; \
		{ $$SUDO apt-get update -qq && $$SUDO env DEBIAN_FRONTEND=noninteractive \
			apt-get install -qq -y --no-install-recommends povray; } >/dev/null 2>&1 \
		|| echo "warning: POV-Ray could not be installed; cross-checks will not run" >&2; }

# Opens reports of studies as their readers do.
chromium:
	@command -v chromium >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1 || { \
		SUDO=; [ "$$(id -u)" = 0 ] || SUDO=sudo; \
		echo "installing Chromium ..."; \
		{ $$SUDO apt-get update -qq && $$SUDO env DEBIAN_FRONTEND=noninteractive \
			apt-get install -qq -y --no-install-recommends chromium; } >/dev/null 2>&1 \
		|| echo "warning: Chromium could not be installed" >&2; }

node:
	@{ command -v node && command -v npm; } >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1 || { \
		SUDO=; [ "$$(id -u)" = 0 ] || SUDO=sudo; \
		echo "installing Node.js ..."; \
		{ $$SUDO apt-get update -qq && $$SUDO env DEBIAN_FRONTEND=noninteractive \
			apt-get install -qq -y --no-install-recommends nodejs npm; } >/dev/null 2>&1 \
		|| echo "warning: Node.js could not be installed" >&2; }

clean:
	rm -rf $(VENV) out
