# The two commands of the README are `make demo` and `make test`; both do their own set-up.
SHELL := /bin/bash
.DELETE_ON_ERROR:

help:  ## What can be made
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 16

demo: setup-build web  ## A simulated rig scans a sample, fits it, and the page shows it (Ctrl-C ends)
	cargo run --release --quiet -- demo $(ARGS)

build: setup-build web  ## The program with its page, in target/release/ridged
	cargo build --release

test: setup-build setup-test web check test-rust test-vendor test-web  ## Everything that must hold
	@echo "all tests passed"

check: web  ## Formatting and lints
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings

test-rust: web  ## Rust tests
	cargo test

test-vendor: web  ## The stage maker's own client against the simulated controller, GTC against the budgets
	cargo test --no-run
	tests/vendor/run target/debug/ridged

test-web: web  ## The page's unit tests, and the page in a real browser against the real daemon
	cargo test --no-run
	cd web && npm run check && npm test && npm run page-test && RIDGED_BIN=../target/debug/ridged npm run e2e

web: web/dist/index.html  ## The page, built into web/dist

web/dist/index.html: web/node_modules/.installed $(shell find web/src web/index.html web/vite.config.ts 2>/dev/null)
	cd web && npm run build

web/node_modules/.installed: web/package.json web/package-lock.json
	cd web && npm ci --no-audit --no-fund
	@touch $@

screenshot: build setup-test  ## docs/screenshot.png from a real run
	cd web && RIDGED_BIN=../target/release/ridged npm run screenshot

setup-build:
	@tools/setup build

setup-test:
	@tools/setup build browser python

.PHONY: help demo build test check test-rust test-vendor test-web web screenshot setup-build setup-test
