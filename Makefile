# One command each, the same on a developer's machine and in CI.
# Needs: make, Rust, Python >= 3.10 (choose one with PYTHON=python3.12). All else goes into .venv.

PYTHON ?= python3
OUT ?= results
# Where the files of the repository can be fetched (https://.../raw/HEAD), for the links of a package.
ADDRESS ?=
VENV := .venv
# Absolute, because some steps run in another directory.
BIN := $(abspath $(VENV))/bin
PY := $(BIN)/python
# What is made for the site.
SITE := docs/build docs/examples docs/api/generated docs/api/examples docs/theory/claims.md

# A changed source of the extension requires a build; Python sources are used in place.
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')

# `maturin develop` finds the environment by VIRTUAL_ENV and refuses two of them.
DEVELOP := env -u CONDA_PREFIX VIRTUAL_ENV="$(abspath $(VENV))" \
           "$(BIN)/maturin" develop --release --locked --extras

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup reproduce test lint bench docs wheel sdist licenses stage clean

help: ## show this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1|\2/p' $(MAKEFILE_LIST) | \
	    while IFS='|' read -r target text; do printf '  %-16s %s\n' "$$target" "$$text"; done

setup: $(VENV)/.dev ## create .venv, build the extension, install the tools for development

reproduce: $(VENV)/.run ## build, then run both experiments: figures and report in results/
	"$(BIN)/stochens" reproduce --out "$(OUT)"

test: $(VENV)/.dev ## all tests: the Rust core without Python, then the Python package
	cargo test --release --locked
	"$(PY)" -m pytest

lint: $(VENV)/.dev ## format, clippy, ruff, mypy --strict, stubs against the extension
	cargo fmt --check
	cargo clippy --release --locked --all-targets -- -D warnings
	PYO3_PYTHON="$(PY)" cargo clippy --release --locked --all-targets --features python -- -D warnings
	"$(BIN)/ruff" check .
	"$(BIN)/ruff" format --check .
	"$(PY)" -m mypy
	"$(PY)" -m mypy.stubtest stochens_rs._core

bench: $(VENV)/.bench ## time the core and the package, compare with peers, write docs/benchmarks.md
	cargo bench --locked
	OPENBLAS_NUM_THREADS=1 "$(PY)" benches/peers.py --write

docs: $(VENV)/.docs ## the site in docs/build/: guide, gallery, theory, API of both languages
	rm -rf $(SITE) build/doctrees
	"$(PY)" docs/theory/_claims.py
	"$(PY)" -m sphinx --fail-on-warning --keep-going --quiet -d build/doctrees docs docs/build
	RUSTDOCFLAGS="-D warnings" cargo doc --release --locked --no-deps
	cp -R "$${CARGO_TARGET_DIR:-target}/doc" docs/build/rust
	"$(PY)" tools/check_site.py docs/build

wheel: stage $(VENV)/.maturin ## build a wheel into dist/, then test it in an environment without Rust
	rm -rf dist/*.whl
	$(if $(MANYLINUX),"$(PY)" -m pip install --quiet --disable-pip-version-check "maturin[zig]")
	cd build/stage && PATH="$(BIN):$$PATH" "$(BIN)/maturin" build --release --locked \
	    --interpreter "$(PY)" --out ../../dist $(if $(MANYLINUX),--zig --compatibility $(MANYLINUX))
	$(call try,dist/*.whl,$(MANYLINUX))

sdist: stage $(VENV)/.maturin ## build a source package into dist/, then test a wheel built from it
	rm -rf dist/*.tar.gz build/from-sdist
	cd build/stage && "$(BIN)/maturin" sdist --out ../../dist
	@# Packed files are from 1980 or so: -m makes them new (see tools/stage.py).
	temp=$$(mktemp -d) && trap 'rm -rf "$$temp"' EXIT && tar -xzmf dist/*.tar.gz -C "$$temp" && \
	    "$(PY)" -m pip wheel --quiet --disable-pip-version-check --no-deps \
	        --wheel-dir build/from-sdist "$$temp"/*
	$(call try,build/from-sdist/*.whl)

licenses: $(VENV)/.created ## write THIRD-PARTY-LICENSES again after a change of Cargo.lock
	"$(PY)" tools/third_party_licenses.py

clean: ## remove everything that make has made, with .venv and results/
	rm -rf $(VENV) results dist build $(SITE) target .mypy_cache .ruff_cache .pytest_cache \
	    .hypothesis .benchmarks
	find python tests benches docs tools -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
	rm -f python/stochens_rs/_core*.so python/stochens_rs/_core*.pyd

# -- stamps: each says "this step was done after its prerequisites last changed" ---------------

$(VENV)/.created:
	@command -v cargo >/dev/null || \
	    { echo "cargo was not found: install Rust (https://rustup.rs), then call make again"; exit 1; }
	@command -v "$(PYTHON)" >/dev/null || \
	    { echo "$(PYTHON) was not found: call make with PYTHON=/path/to/python"; exit 1; }
	@"$(PYTHON)" -c 'import sys; v = sys.version_info; \
	    sys.exit(None if v >= (3, 10) else "Python >= 3.10 is needed, and $(PYTHON) is %d.%d: call make with PYTHON=python3.12 or the like" % v[:2])'
	@"$(PYTHON)" -m venv $(VENV) || \
	    { echo "$(PYTHON) cannot create environments: install its venv module (Debian: python3-venv)"; exit 1; }
	@touch $@

$(VENV)/.maturin: $(VENV)/.created
	"$(PY)" -m pip install --quiet --disable-pip-version-check "maturin>=1.9.4,<2"
	@touch $@

$(VENV)/.run: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot
	@touch $@

# The tools include everything that a run needs, hence the second stamp.
$(VENV)/.dev: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,dev
	@touch $(VENV)/.run $@

$(VENV)/.bench: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,bench
	@touch $(VENV)/.run $@

$(VENV)/.docs: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,docs
	@touch $(VENV)/.run $@

# -- packages ----------------------------------------------------------------------------------

# The packed files, with a README without relative links.
stage: $(VENV)/.created
	"$(PY)" tools/stage.py build/stage --address "$(ADDRESS)"

# With glibc, zig links against the symbols of an old version, so that the wheel also runs on old
# systems; elsewhere the tag is that of the platform.
MANYLINUX = $(if $(findstring linux-gnu,$(shell rustc -vV)),manylinux2014)

# Not in target/, where cargo would confuse the copies with the sources.
wheel sdist: export CARGO_TARGET_DIR := $(CURDIR)/build/target

# $(call try,WHEEL,TAG): PATH holds an empty environment only, so nothing can be compiled.
define try
	rm -rf build/check && "$(PY)" -m venv build/check
	cd build/check && PATH="$$PWD/bin" "$$PWD/bin/python" -m pip install --quiet \
	    --disable-pip-version-check --only-binary :all: ../../$(1)
	cd build/check && PATH="$$PWD/bin" "$$PWD/bin/python" -I ../../tools/check_wheel.py ../../$(1) $(2)
endef
