# One command each, the same on a developer's machine and in CI.
# Needs: make, Rust, Python >= 3.10 (choose one with PYTHON=python3.12). All else goes into .venv.

PYTHON ?= python3
OUT ?= results
VENV := .venv
# Absolute, because some steps run in another directory.
BIN := $(abspath $(VENV))/bin
PY := $(BIN)/python

# A changed source of the extension makes it stale; Python sources are used where they lie.
SOURCES := Cargo.toml Cargo.lock pyproject.toml $(shell find rust -name '*.rs')

# `maturin develop` finds the environment by VIRTUAL_ENV and refuses two of them.
DEVELOP := env -u CONDA_PREFIX VIRTUAL_ENV="$(abspath $(VENV))" \
           "$(BIN)/maturin" develop --release --locked --extras

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup reproduce test lint bench docs wheel clean

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

bench: $(VENV)/.bench ## time the core and the package against its peers: docs/benchmarks.md
	cargo bench --locked
	OPENBLAS_NUM_THREADS=1 "$(PY)" benches/peers.py --write

docs: $(VENV)/.docs ## API pages of both languages in docs/build/
	RUSTDOCFLAGS="-D warnings" cargo doc --release --locked --no-deps
	rm -rf docs/build
	mkdir -p docs/build
	cp -R "$${CARGO_TARGET_DIR:-target}/doc" docs/build/rust
	"$(PY)" -m pdoc --docformat numpy --math -o docs/build/python stochens_rs

wheel: $(VENV)/.maturin ## build a wheel into dist/, then try it where there is no Rust
	rm -rf dist/*.whl build/wheel-check
	"$(BIN)/maturin" build --release --locked --interpreter "$(PY)" --out dist
	"$(PY)" -m venv build/wheel-check
	@# PATH holds the empty environment only: nothing can be compiled.
	cd build/wheel-check && PATH="$$PWD/bin" "$$PWD/bin/python" -m pip install --quiet \
	    --disable-pip-version-check --only-binary :all: ../../dist/*.whl
	cd build/wheel-check && PATH="$$PWD/bin" "$$PWD/bin/python" -I -c "$$WHEEL_CHECK"

clean: ## remove everything that make made, .venv and results/ included
	rm -rf $(VENV) results dist build docs/build target .mypy_cache .ruff_cache .pytest_cache \
	    .hypothesis .benchmarks
	find python tests benches docs -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
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

# Whoever has the tools also has what a run needs, hence the second stamp.
$(VENV)/.dev: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,dev
	@touch $(VENV)/.run $@

$(VENV)/.bench: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,bench
	@touch $(VENV)/.run $@

$(VENV)/.docs: $(VENV)/.maturin $(SOURCES)
	$(DEVELOP) plot,docs
	@touch $(VENV)/.run $@

define WHEEL_CHECK
import shutil
import stochens_rs as se
assert shutil.which("cargo") is None
A = [[0.9, 0.2], [-0.1, 0.8]]
fit = se.fuse(se.sample(A, 1000, rng=1), "alse", target=A)
assert fit.status == "optimal" and fit.error < 1e-3, (fit.status, fit.error)
print("wheel works: sampled 1000 realizations and fused them, error", fit.error)
endef
export WHEEL_CHECK
