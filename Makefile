# The two commands of the README are `make demo` and `make test`; both do their own set-up.
SHELL := /bin/bash
.DELETE_ON_ERROR:
# The tests run in code of one unit per crate, which compiles in the least processor time and runs fastest. `cargo test` by hand
# builds in small units, so that a change is compiled again soon.
export CARGO_INCREMENTAL := 0
export CARGO_PROFILE_DEV_CODEGEN_UNITS := 1
export CARGO_PROFILE_DEV_DEBUG := false
# Many tests wait for a rig or a daemon, so two of them share a processor.
export RUST_TEST_THREADS := $(shell echo $$((2 * $$(nproc))))

help:  ## What can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 20

demo: setup-build web  ## A simulated rig scans a part, fits it, and the page shows it (Ctrl-C ends)
	cargo run --release --quiet -- demo $(ARGS)

build: setup-build web  ## The program with its page, in target/release/ridged
	cargo build --release

# Packed relocations need glibc 2.36, that of Debian 12, and save half a megabyte.
dist: setup-build web  ## The stripped program and a Debian package with unit, udev rule, manual pages and completions, in target/debian
	cargo rustc --profile dist --bin ridged -- -C link-arg=-Wl,-z,pack-relative-relocs
	tools/dist

test-dist: dist  ## The package in a fresh Debian folder: installed, used, upgraded, removed (needs root)
	tests/dist/run

# What needs no program runs beside the build of the Rust tests.
test: setup-build setup-test web  ## Everything that must hold
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target build-tests test-page check-python docs
	@$(MAKE) --no-print-directory test-rust
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target test-e2e test-api test-python day test-vendor
	@echo "all tests passed"

build-tests: check
	cargo test --no-run

check: web  ## Formatting and lints
	cargo fmt --check
	RUSTC_WORKSPACE_WRAPPER=$(CURDIR)/tools/lint cargo build --all-targets

test-rust: web  ## Rust tests
	cargo test

test-times: web  ## The slowest Rust tests
	@tools/test_times.py $(ARGS)

soak: web  ## Scans under seeded faults: make soak SEEDS=0..10000
	RIDGED_SOAK_SEEDS=$(or $(SEEDS),0..1000) cargo test --test it soak:: -- --nocapture

faults: web  ## The table of faults (docs/reference/faults.md) with the results of its tests
	@tools/fault_table.py

fuzz: web  ## Changed inputs through every parser: make fuzz CASES=2000000
	RIDGED_FUZZ_CASES=$(or $(CASES),100000) cargo test --test it fuzz::

code-figures:  ## Lines of code and tests, and the longest files
	@tools/code_figures.py

test-vendor: web  ## The stage maker's own client against the simulated controller, GTC against the budgets
	cargo test --no-run
	tests/vendor/run target/debug/ridged

test-slurm: build  ## Two Slurm nodes on this machine: shards give the bits of one run, also where a node dies (needs root)
	tests/slurm/run target/release/ridged

docs:  ## The documents as a site in target/docs, with all links checked
	tests/documents/run

check-python:  ## Types of the Python package (makes its venv)
	python/check

test-python: web  ## The Python package with a live daemon, and its notebook
	cargo test --no-run
	python/run target/debug/ridged

test-api: web  ## A live daemon against its OpenAPI document: requests and events
	cargo test --no-run
	tests/api/run target/debug/ridged

day: web  ## A day of parts by page, curl, Python and commands, with the same rows at the end: make day PARTS=40
	cargo test --no-run
	tests/day/run $(or $(PARTS),3) target/debug/ridged

test-web: test-page test-e2e  ## The page's unit tests, and the page in a real browser against the real daemon

test-page: web
	cd web && npm run check && npm test && npm run page-test

test-e2e: web
	cargo test --no-run
	cd web && RIDGED_BIN=../target/debug/ridged npm run e2e

web: web/dist/index.html  ## The page, built into web/dist

web/dist/index.html: web/node_modules/.installed $(shell find web/src scenes web/index.html web/*.ts web/*.css -type f 2>/dev/null; find docs -name '*.md')
	cd web && npm run build

web/node_modules/.installed: web/package.json web/package-lock.json
	cd web && npm ci --no-audit --no-fund
	@touch $@

screenshots: build setup-test  ## docs/pictures/screenshot*.png from a day on the simulated rig
	cd web && RIDGED_BIN=../target/release/ridged npm run screenshot

bench-peers: bench-peers-fit bench-peers-trace  ## ridged against what one would use instead

bench-peers-fit: setup-build web  ## Seconds of a fit beside scipy.optimize.least_squares, one run (makes its own venv)
	@tools/setup python
	benches/peers/run

bench-peers-trace: build  ## ridged trace against Mitsuba 3, one field, one run (needs its own venv: made here)
	@tools/setup python llvm
	test -x target/peers-venv/bin/python || python3 -m venv target/peers-venv
	target/peers-venv/bin/python -c 'import mitsuba' 2>/dev/null || target/peers-venv/bin/pip install --quiet mitsuba==3.9.1 numpy
	DRJIT_LIBLLVM_PATH=$$(ls /usr/lib/*/libLLVM-19.so* 2>/dev/null | head -1) \
	  target/peers-venv/bin/python tools/bench_trace.py --ridged target/release/ridged $(ARGS)

bench-results: web  ## Time of queries over 100,000 fits
	cargo bench --bench results

setup-build:
	@tools/setup build

setup-test:
	@tools/setup build browser python

.PHONY: bench-peers bench-peers-fit bench-peers-trace bench-results code-figures day faults fuzz help demo dist docs build build-tests test check check-python test-api test-dist test-e2e test-page test-python test-rust test-slurm test-times test-vendor test-web web screenshots setup-build setup-test soak
