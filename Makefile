# The two commands of the README, `make fly` and `make test`, each do all of their own set-up.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
STAMP := $(VENV)/.installed
BIN := $(VENV)/bin
# Some tests wait for real sockets and processes: one worker more than cores keeps the cores busy.
PYTEST_WORKERS ?= 3

.PHONY: install fly test browser docs paper refs fuzz clean

install: $(STAMP)

$(STAMP): requirements.lock requirements-clients.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "gs needs Python 3.11 or newer: set PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-clients.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(STAMP)

# Flies eight vehicles into a cube and back in the emulator; says where the log and the pictures are.
fly: $(STAMP)
	$(BIN)/gs fly --mission cube8.yaml --dry-run --seed 1 --log flights/cube8.tlog --force
	$(BIN)/gs report flights/cube8.tlog -o flights/cube8-report
	@echo
	@echo 'Next, in this folder:'
	@echo '  $(BIN)/gs missions                                   # what comes along'
	@echo '  $(BIN)/gs fly --mission sequence8 --dry-run          # several formations in one flight'
	@echo '  $(BIN)/gs init mine                                  # a folder with a mission of your own'
	@echo 'To type gs alone: source $(BIN)/activate   (groundstation is a second name, where gs is Ghostscript)'

# Everything that has to hold before a commit.
test: $(STAMP) browser
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(PYTEST_WORKERS)

# Debian's chromium, for the tests of the console; where it cannot be installed they are skipped, and say so.
browser:
	@command -v chromium >/dev/null || { \
	  as=; [ "$$(id -u)" = 0 ] || as='sudo -n'; \
	  apt() { timeout 200 $$as env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=60 -o Acquire::Retries=0 -o Acquire::http::Timeout=20 "$$@" > /dev/null; }; \
	  add() { apt install -y --no-install-recommends chromium; }; \
	  add || { apt update && add; } || \
	  echo 'no chromium, and apt-get could not install it here: tests in a browser are skipped; apt-get install chromium'; }

# Flies the reference flights again, keeps their logs and prints what has changed: on purpose only.
refs: $(STAMP)
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m tests.reference

# Draws pages and figures from the program (a test fails when pages are not up to date), and builds the site in build/site.
docs: $(STAMP)
	$(BIN)/python -m tests.docs

# Flies the paper's experiment by the paper's pure law, and draws its Figures 2 to 5 from that on one page.
paper: $(STAMP)
	$(BIN)/gs fly --mission paper_cube8 --dry-run --seed 1 --log flights/paper_cube8.tlog --force
	$(BIN)/python -m tests.docs.paper flights/paper_cube8.tlog build/paper

# Random bytes, and real input bent out of shape, through everything that reads bytes from outside; about half an hour.
FUZZ_BYTES ?= 10000000
FUZZ_SEED ?= 1
fuzz: $(STAMP)
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz --bytes $(FUZZ_BYTES) --seed $(FUZZ_SEED)

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache build dist
