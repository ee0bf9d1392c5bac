# make demo   set up, then reconstruct and measure the sample print
# make test   set up, then run every check
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test setup system lint check format benchmark lock clean

demo: setup
	$(BIN)/vialight demo --out demo

test: setup system lint check

# What tests need of the system, as command:package.  Without the right to install it they are skipped, but never under CI.
SYSTEM := chromium:chromium
SYSTEM += Xvfb:xvfb Xvfb:libgl1-mesa-dri

system:
	@for pair in $(SYSTEM); do command -v $${pair%%:*} >/dev/null || missing="$$missing $${pair##*:}"; done; \
	if [ -z "$$missing" ]; then exit 0; fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get -qq update && \
		DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends $$missing >/dev/null; then exit 0; fi; \
	echo "missing, so that some tests are skipped:$$missing; as root: apt-get install$$missing"; [ -z "$$CI" ]

# No system packages: every part that vialight runs with comes as a wheel, and pictures are drawn without OpenGL.
setup: .venv/ready

.venv/ready: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("vialight needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $@

lint: setup
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

check: setup
	$(BIN)/pytest

format: setup
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

# The peers have a lock and an environment of their own: nothing of vialight needs them.
benchmark: setup
	$(PYTHON) -m venv .venv-benchmark
	.venv-benchmark/bin/pip install --quiet --require-hashes -r requirements-benchmark.lock
	.venv-benchmark/bin/pip install --quiet --no-build-isolation --no-deps -e .
	.venv-benchmark/bin/python benchmarks/reconstruction.py --markdown docs/benchmarks.md

# Needs uv; run it after changing the dependencies in pyproject.toml.
lock:
	uv pip compile --quiet --universal --generate-hashes --no-annotate --no-header --python-version 3.11 \
		--group test pyproject.toml -o requirements.lock

clean:
	rm -rf .venv .venv-benchmark demo .mypy_cache .pytest_cache .ruff_cache .hypothesis
