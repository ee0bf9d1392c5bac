# make demo   set up, then plan a part and print it on the digital twin, measured while it forms
# make test   set up, then run every check
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test setup system devices lint check format benchmark lock clean

demo: setup
	$(BIN)/vialight demo --out demo

test: setup system devices lint check

# What tests need of the system, as name:package, the name being that of a command, of a module of pkg-config or of an
# introspected library.  Without the right to install it tests are skipped, but never under CI.
SYSTEM := chromium:chromium Xvfb:xvfb Xvfb:libgl1-mesa-dri
SYSTEM += arv-fake-gv-camera-0.8:aravis-tools Aravis-0.8:gir1.2-aravis-0.8 cc:gcc pkg-config:pkg-config
SYSTEM += gobject-introspection-1.0:libgirepository1.0-dev cairo:libcairo2-dev

system:
	@for pair in $(SYSTEM); do name=$${pair%%:*}; \
		command -v $$name >/dev/null || pkg-config --exists $$name 2>/dev/null || \
		ls /usr/lib/girepository-1.0/$$name.typelib /usr/lib/*/girepository-1.0/$$name.typelib 2>/dev/null | grep -q . || \
		missing="$$missing $${pair##*:}"; done; \
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

# Drivers of instruments, for their tests.  What is built against the system's libraries may be out of reach.
devices: .venv/devices

.venv/devices: .venv/ready requirements-devices.lock requirements-aravis.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-devices.lock
	@if pkg-config --exists gobject-introspection-1.0 cairo; then set -ex; \
		$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-aravis.lock; touch $@; \
	else echo "PyGObject cannot be built, so that the tests of Aravis are skipped"; [ -z "$$CI" ]; fi

lint: setup
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports

# Two halves: what only computes, on all of two cores; then what keeps pace with the clock, one test after another.  A
# virtual machine may stand still itself for longer than a bound allows: there a test has to fail twice.
check: setup
	$(BIN)/pytest -m "not alone" --numprocesses 3 --dist loadfile --no-loadscope-reorder -p no:rerunfailures
	$(BIN)/pytest -m alone --reruns 1 --max-suite-reruns 5 --rerun-show-tracebacks

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
	for group in devices aravis; do uv pip compile --quiet --universal --generate-hashes --no-annotate --no-header \
		--python-version 3.11 --group pyproject.toml:$$group -c requirements.lock -o requirements-$$group.lock; done

clean:
	rm -rf .venv .venv-benchmark demo .mypy_cache .pytest_cache .ruff_cache .hypothesis
