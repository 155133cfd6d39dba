# Two commands on a fresh machine: `make demo` and `make test`. Both make .venv themselves.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test test-hid test-report lint bench bias crosscheck validate povray chromium clean help

help:
	@echo "make demo   set up, render the calibration board, say where the picture lies"
	@echo "make test   set up (POV-Ray by apt where missing), lint, run all tests"
	@echo "make test-hid  the LED cases on real HID devices, in two virtual machines (qemu by apt where missing)"
	@echo "make test-report  open the report of a study in a real browser (Chromium by apt where missing)"
	@echo "make lint   ruff and mypy --strict"
	@echo "make bench  speed, overhead, memory, and what a tolerance costs, measured on this machine"
	@echo "make crosscheck   Radiance against POV-Ray on rad_scenes/crosscheck"
	@echo "make validate    the score card of closed forms, with plots in out/validate/index.html"
	@echo "make bias   bias of algorithms on predicted images, with plots"

demo: $(READY)
	@$(BIN)/radwrap render rad_scenes/bench_board/scene.toml --out out/demo
	@echo "The picture is out/demo/gray.png"

# Two processes, as the machine that the suite is timed on has two cores; tests of a file share what they make.
test: $(READY) povray lint
	@$(BIN)/python -m pytest -n 2 --dist loadfile

test-hid: $(READY)
	@$(BIN)/python scripts/test_hid.py

test-report: $(READY) chromium
	@$(BIN)/python -m pytest tests/study/report_in_browser.py

lint: $(READY)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

bench: $(READY)
	@$(BIN)/python scripts/bench.py; first=$$?; $(BIN)/python scripts/bench_tolerance.py && exit $$first

bias: $(READY)
	@$(BIN)/python scripts/bias_studies.py

crosscheck: $(READY) povray
	@$(BIN)/python scripts/crosscheck.py

validate: $(READY)
	@$(BIN)/radwrap validate --out out/validate

# A changed lock file or project file sets the environment up again; otherwise this is done at once.
$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "error: Python 3.11 or newer is needed; on Debian: apt install python3, or name one with PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
		{ echo "error: Python's venv module is missing; on Debian: apt install python3-venv"; exit 1; }
	@echo "setting up $(VENV) ..."
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $(READY)

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

clean:
	rm -rf $(VENV) out
