# Each target is a line or two that a person could type. The two that matter: make demo, make test.
.PHONY: setup demo bench compat test lint stubs release deps clean

PYTHON := .venv/bin/python

## Everything `cargo build` needs: Debian packages (apt, as root or with sudo), .venv, native/lib.
setup:
	scripts/setup.sh build

## Collect, evaluate and draw, from nothing, into runs/demo/NNN.
demo: setup
	cargo build --release -p palr-gym
	target/release/palr-gym demo $(ARGS)

## Everything that must hold. (nextest builds the program, which pytest then starts.)
test: setup-test lint
	cargo nextest run --workspace
	cargo test --doc --workspace
	$(PYTHON) -m pytest

lint: setup-test
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --quiet --workspace --no-deps
	.venv/bin/buf lint proto
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/pyright

setup-test:
	scripts/setup.sh test
.PHONY: setup-test

## Measures against the references; writes bench/results.json and README's table. ONLY=prefix.
bench: setup
	cargo build --release -p palr-gym -p palr-gym-bench
	[ -x .venv-bench/bin/python ] || python3 -m venv .venv-bench
	.venv-bench/bin/python -m pip install -q --disable-pip-version-check -r requirements/bench.txt ./client-py
	.venv-bench/bin/python -m pip install -q --disable-pip-version-check --no-deps -r requirements/remote-gym.txt
	.venv-bench/bin/python -m bench.run $(if $(ONLY),--only $(ONLY))

## Tries heavy peers that `make test` does without: torch, stable-baselines3, a CleanRL-style loop,
## remote-gym. Gigabytes.
compat: setup
	cargo build -p palr-gym
	[ -x .venv-compat/bin/python ] || python3 -m venv .venv-compat
	.venv-compat/bin/python -m pip install -q --disable-pip-version-check -r requirements/compat.txt ./client-py
	.venv-compat/bin/python -m pip install -q --disable-pip-version-check --no-deps -r requirements/remote-gym.txt
	.venv-compat/bin/python -m pytest tests/compat -W default

## Regenerates the Python stubs after a change of proto/.
stubs: setup-test
	$(PYTHON) scripts/generate_python_stubs.py

release: setup
	cargo build --release -p palr-gym

## Unused and unwanted dependencies. Needs cargo-machete and cargo-deny (cargo install).
deps:
	cargo machete
	cargo deny check bans licenses sources

clean:
	rm -rf target .venv .venv-bench .venv-compat native examples/node/node_modules examples/node/dist examples/node/src/generated
