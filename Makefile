# One command each to set up, show, check and measure. Each sets up .venv by itself, once.
#   make demo    replay Victoria Park through the HTTP service and draw the map
#   make test    lint, type-check and run the tests
#   make bench   measure against the budgets (benchmarks/RESULTS.md says how)

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# Versions and hashes of everything, for every platform; nothing in it says where it came from.
COMPILE := UV_CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/uv pip compile --quiet --universal --python-version 3.11 \
	--generate-hashes --no-emit-index-url --no-emit-find-links $(if $(UPGRADE),--upgrade)

# The first interpreter that is new enough and can make an environment; PYTHON=... chooses another.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	command -v $$p >/dev/null && $$p -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)

.PHONY: setup demo test lint format type pytest bench lock clean

setup: $(READY)

$(READY): pyproject.toml requirements.lock
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer with venv is needed (on Debian: apt install python3-venv);" \
		"make PYTHON=/path/to/python3.11 names one" >&2; exit 1; }
	@echo "Setting up $(VENV) with $(PYTHON) (once; a few minutes on a slow connection)"
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@echo "Compiling the kernel"
	@$(BIN)/python -c "import submaps.mapper, submaps.atlas.joining"
	@touch $@

demo: $(READY)
	$(BIN)/submaps replay victoria-park --plot victoria_park.png

test: lint type pytest

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

type: $(READY)
	$(BIN)/mypy

pytest: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest

bench: $(READY)
	@for script in $(filter-out %/common.py,$(wildcard benchmarks/[a-z]*.py)); do echo "== $$script"; $(BIN)/python -m benchmarks.$$(basename $$script .py) || exit 1; done

lock: $(READY)
	$(COMPILE) --all-extras --output-file requirements.lock pyproject.toml
	$(COMPILE) --constraints requirements.lock --output-file docker/requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) .cache build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis victoria_park.png
