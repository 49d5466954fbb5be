# One command each, the same on a developer's machine and in CI.
# Needs: make, Python >= 3.10 (choose one with PYTHON=python3.12), a C linker. All else goes into .venv,
# and Rust, where there is none that is new enough, into the user's cache.

PYTHON ?= python3
OUT ?= results
# Where the files of the repository can be fetched (https://.../raw/HEAD), for the links of a package.
ADDRESS ?=
MINUTES ?= 3
# Each file of tests runs in one process; a process for each core.
PARALLEL ?= --numprocesses auto
LIBRARY := $(if $(findstring Darwin,$(shell uname)),libstochens.dylib,libstochens.so)
VENV := .venv
# Absolute, because some steps run in another directory.
BIN := $(abspath $(VENV))/bin
PY := $(BIN)/python
# What is made for the site.
SITE := docs/build docs/examples docs/api/generated docs/api/examples docs/theory/claims.md

# Rust in PATH or where its installer puts it; else RUST, which the rule for it installs there.
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/puccinialin
RUST :=
export PATH := $(PATH):$(or $(CARGO_HOME),$(HOME)/.cargo)/bin
NEEDED := $(shell sed -n 's/^rust-version = "1\.\([0-9]*\)"/\1/p' Cargo.toml)
ifeq ($(shell PATH="$(PATH)" cargo --version 2>/dev/null | awk -F'[ .]' '$$2 > 1 || $$3 >= $(NEEDED)'),)
RUST := $(CACHE)/.ready
export RUSTUP_HOME := $(CACHE)/rustup
export CARGO_HOME := $(CACHE)/cargo
export PATH := $(CARGO_HOME)/bin:$(PATH)
endif

# A changed source of the extension requires a build; Python sources are used in place.
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')

# `maturin develop` finds the environment by VIRTUAL_ENV and refuses two of them.
DEVELOP := env -u CONDA_PREFIX VIRTUAL_ENV="$(abspath $(VENV))" \
           "$(BIN)/maturin" develop --release --locked --extras

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup reproduce test soak quick lint bench docs wheel wheels sdist licenses fuzz unsafe stage clean

help: ## show this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1|\2/p' $(MAKEFILE_LIST) | \
	    while IFS='|' read -r target text; do printf '  %-16s %s\n' "$$target" "$$text"; done

setup: $(VENV)/.dev ## create .venv, build the extension, install the tools for development

reproduce: $(VENV)/.run ## build, then run both experiments: figures and report in results/
	"$(PY)" -m paper reproduce --out "$(OUT)"

test: export PROPTEST_RNG_SEED ?= 1
test: $(VENV)/.dev ## all tests: the Rust core without Python, then the Python package
	cargo test --release --locked
	"$(PY)" -m pytest $(PARALLEL)

soak: $(VENV)/.dev ## the slow tests of Python with all their data sets, which `make test` has fewer of
	SOAK=1 "$(PY)" -m pytest $(PARALLEL) -m slow

quick: $(VENV)/.dev ## what a change needs at once: a fast build of the extension, the tests not marked slow
	cargo rustc --quiet --profile quick --locked --lib --features python --crate-type cdylib
	@# The next `make test` builds the release again.
	rm -f "$(VENV)/.dev" "$(VENV)/.run"
	cp "$${CARGO_TARGET_DIR:-target}/quick/$(LIBRARY)" python/stochens_rs/_core.abi3.so
	"$(PY)" -m pytest $(PARALLEL) -m "not slow" -q

lint: $(VENV)/.dev ## lines per room, format, clippy, rustdoc, ruff, mypy --strict, stubs against the extension
	"$(PY)" tools/lines.py
	@# side by side: the checks of types leave a core idle
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint-rust lint-python

.PHONY: lint-rust lint-python
lint-rust:
	cargo fmt --check
	@# with the same features of the dependencies three times: they are checked once
	PYO3_PYTHON="$(PY)" cargo clippy --release --locked --all-targets --features python -- -D warnings
	cargo clippy --release --locked --all-targets -- -D warnings
	PYO3_PYTHON="$(PY)" RUSTDOCFLAGS="-D warnings" cargo doc --release --locked --no-deps --features python

lint-python:
	"$(BIN)/ruff" check .
	"$(BIN)/ruff" format --check .
	"$(PY)" -m mypy
	"$(PY)" -m mypy tests/python/typed_calls.py
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
	$(call build,$(if $(MANYLINUX),--zig --compatibility $(MANYLINUX)))
	"$(PY)" tools/check_wheel.py dist $(MANYLINUX)

wheels: stage $(VENV)/.maturin ## cross-build the wheels for Linux (two processors, two C libraries, with and without GIL)
	rm -rf dist/*.whl
	"$(PY)" -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: -r packaging/release.txt
	rustup target add $(LINUX)
	$(foreach target,$(LINUX),$(call build,$(FREE) --zig --target $(target) \
	    --compatibility $(if $(findstring musl,$(target)),musllinux_1_2,manylinux2014)) && ) true
	"$(PY)" tools/check_wheel.py dist manylinux2014

sdist: stage $(VENV)/.maturin ## build a source package into dist/, then test a wheel built from it
	rm -rf dist/*.tar.gz build/from-sdist
	cd build/stage && "$(BIN)/maturin" sdist --out ../../dist
	@# Packed files are from 1980 or so: -m makes them new (see tools/stage.py).
	temp=$$(mktemp -d) && trap 'rm -rf "$$temp"' EXIT && tar -xzmf dist/*.tar.gz -C "$$temp" && \
	    "$(PY)" -m pip wheel --quiet --disable-pip-version-check --no-deps \
	        --wheel-dir build/from-sdist "$$temp"/*
	"$(PY)" tools/check_wheel.py build/from-sdist

licenses: $(VENV)/.created | $(RUST) ## write THIRD-PARTY-LICENSES again after a change of Cargo.lock
	"$(PY)" tools/third_party_licenses.py

fuzz: $(VENV)/.dev ## search for files that readers neither read nor refuse, for MINUTES; keeps them in fuzz/corpus/
	PROPTEST_CASES=100000 cargo test --release --locked --lib -- garbage forged any_damage no_number
	"$(PY)" fuzz/readers.py --minutes $(MINUTES)

unsafe: $(VENV)/.maturin ## run the tests of unsafe code under valgrind, which must be installed
	CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="valgrind --error-exitcode=1" \
	    cargo test --release --locked --lib -- --test-threads 1 $(UNSAFE)

# stores past the caches, vector registers, unchecked tables
UNSAFE := nontemporal:: simd:: slse_tables:: sample::categorical sample::tests \
          sample::sequence stream::tests singleton_rows the_layout_of

clean: ## remove everything that make has made, with .venv and results/
	rm -rf $(VENV) results dist build $(SITE) target .mypy_cache .ruff_cache .pytest_cache \
	    .hypothesis .benchmarks
	find python paper tests benches docs tools -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
	rm -f python/stochens_rs/_core*.so python/stochens_rs/_core*.pyd

# -- stamps: each says "this step was done after its prerequisites last changed" ---------------

$(VENV)/.created:
	@command -v "$(PYTHON)" >/dev/null || \
	    { echo "$(PYTHON) was not found: call make with PYTHON=/path/to/python"; exit 1; }
	@"$(PYTHON)" -c 'import sys; v = sys.version_info; \
	    sys.exit(None if v >= (3, 10) else "Python >= 3.10 is needed, and $(PYTHON) is %d.%d: call make with PYTHON=python3.12 or the like" % v[:2])'
	@"$(PYTHON)" -m venv $(VENV) || \
	    { echo "$(PYTHON) cannot create environments: install its venv module (Debian: python3-venv)"; exit 1; }
	@touch $@

$(CACHE)/.ready: | $(VENV)/.created
	@echo "Rust >= 1.$(NEEDED) was not found: installing it into $(CACHE) (nothing else is changed)"
	@mkdir -p "$(CACHE)"
	@{ "$(PY)" -m pip install --disable-pip-version-check "puccinialin>=0.1.14,<0.2" && \
	    "$(PY)" -m puccinialin --location "$(CACHE)"; } >"$(VENV)/rust.log" 2>&1 || \
	    { echo "Rust could not be installed ($$(tail -n 1 "$(VENV)/rust.log")): install it from https://rustup.rs, then call make again"; exit 1; }
	@touch $@

$(VENV)/.maturin: $(VENV)/.created | $(RUST)
	"$(PY)" -m pip install --quiet --disable-pip-version-check "maturin>=1.9.4,<2"
	@touch $@

$(VENV)/.run: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) paper
	@touch $@

# The tools include everything that a run needs, hence the second stamp.
$(VENV)/.dev: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) paper,dev
	@touch $(VENV)/.run $@

$(VENV)/.bench: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) paper,bench
	@touch $(VENV)/.run $@

$(VENV)/.docs: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) paper,docs
	@touch $(VENV)/.run $@

# -- packages ----------------------------------------------------------------------------------

# The packed files, with a README without relative links.
stage: $(VENV)/.created
	"$(PY)" tools/stage.py build/stage --address "$(ADDRESS)"

# With glibc, zig links against the symbols of an old version, so that the wheel also runs on old
# systems; elsewhere the tag is that of the platform.
MANYLINUX = $(if $(findstring linux-gnu,$(shell PATH="$(PATH)" rustc -vV)),manylinux2014)

LINUX := $(foreach libc,gnu musl,x86_64-unknown-linux-$(libc) aarch64-unknown-linux-$(libc))

# Free-threaded Python, which abi3 does not cover; maturin knows it without an interpreter.
FREE := 3.14t

# All crates optimized together: the extension is 7 % smaller, and takes minutes longer to build.
wheel wheels sdist: export CARGO_PROFILE_RELEASE_LTO := fat
wheel wheels sdist: export CARGO_PROFILE_RELEASE_CODEGEN_UNITS := 1
wheel wheels sdist: export CARGO_PROFILE_RELEASE_STRIP := symbols
# Only functions up to this cost are copied into their callers (225 by default): 6 % smaller, and as
# fast within the noise.
wheel wheels sdist: export RUSTFLAGS := $(RUSTFLAGS) -C llvm-args=-inline-threshold=100

# Not in target/, where cargo would confuse the copies with the sources.
wheel wheels sdist: export CARGO_TARGET_DIR := $(CURDIR)/build/target

# $(call build,INTERPRETERS OPTIONS): from the packed sources into dist/.
build = (cd build/stage && PATH="$(BIN):$$PATH" "$(BIN)/maturin" build --release --locked \
    --compression-level 9 --out ../../dist --interpreter "$(PY)" $(1))
