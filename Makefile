PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-demo
CORES := $(shell $(PYTHON) -c "import os; print(min(os.cpu_count() or 1, 4))")
# More than cores, for slow tests mostly wait.
ALL_WORKERS := $(shell expr $(CORES) + 2)
PYTEST = $(BIN)/python -m pytest --dist loadfile --no-loadscope-reorder
# Tests start hundreds of processes: without byte code each of them compiles 400 modules.
unexport PYTHONDONTWRITEBYTECODE
export CARGO_TARGET_DIR ?= $(CURDIR)/.cache/rust-target
# Zenoh's own router, of the version of eclipse-zenoh here, is built once on a machine, not once in a clone.
ZENOHD_VERSION := 1.10.2
ZENOHD_ROOT ?= $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/robrain/zenohd-$(ZENOHD_VERSION)
ZENOHD := $(ZENOHD_ROOT)/bin/zenohd

.PHONY: demo test test-all nightly browser kernels ros2-interfaces test-rust check docs reference bench figures soak endurance mutants format install clean

demo: $(DEMO_STAMP) ## a team explores, seen in the browser, recorded
	@$(BIN)/robrain demo $(ARGS)

install: $(STAMP)

$(DEMO_STAMP): pyproject.toml constraints.txt
	@test -x $(BIN)/uv || { $(PYTHON) -m venv $(VENV) && $(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt uv; }
	@echo "installing what the demo needs into $(VENV) (once)"
	@$(BIN)/uv pip install --python $(BIN)/python -c constraints.txt -e '.[sim,team]'
	@touch $@

$(STAMP): $(DEMO_STAMP)
	@echo "installing what the tests and checks need into $(VENV) (once)"
	@$(BIN)/uv pip install --python $(BIN)/python -c constraints.txt -e '.[all,dev,docs]'
	@touch $@

test: install browser kernels ## the tests that are not marked slow, side by side: four minutes on two cores (ARGS="-n 0 tests/agent" for less)
	$(PYTEST) --numprocesses $(CORES) -m "not slow" $(ARGS)

test-all: install browser kernels ros2-interfaces ## all tests: twenty minutes on two cores
	$(PYTEST) --numprocesses $(ALL_WORKERS) $(ARGS)

nightly: mutants soak endurance bench ## what takes hours: mutants, soaks, endurance, all figures

browser: ## Chromium for the dashboard's tests, from the distribution's packages where that is allowed
	@if ! test -x /usr/bin/chromium && test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then \
		echo "installing chromium (once)"; apt-get install --yes --quiet=2 chromium >/dev/null || true; \
	fi
	@test -x /usr/bin/chromium || echo "no /usr/bin/chromium: the dashboard's browser tests will be skipped" >&2

kernels: install ## compiled once, before many tests at a time need them
	@$(BIN)/python -c "from robrain.deploy.processes.kernels import prepare_kernels; prepare_kernels()"

ros2-interfaces: install ## interfaces of ROS 2 that the package index lacks, for tests: built once, for a minute
	@$(BIN)/python -m tests.ros2_interfaces.build

test-rust: install ## the plugin in Rust, and secured teams on zenohd; both are built, for minutes, once
	@if command -v cargo >/dev/null; then \
		cargo build --release --manifest-path examples/rust_plugin/Cargo.toml && \
		$(BIN)/python -m pytest examples/rust_plugin/test_gauge.py $(ARGS) && \
		$(MAKE) --no-print-directory $(ZENOHD) && \
		ROBRAIN_ZENOHD=$(ZENOHD) $(BIN)/python -m pytest $(ON_ZENOHD) $(ARGS); \
	elif [ -n "$$CI" ]; then \
		echo "test-rust: there is no cargo here; CI must have one (https://rustup.rs)" >&2; exit 1; \
	else \
		echo "test-rust: skipped, there is no cargo here (https://rustup.rs)"; \
	fi

ON_ZENOHD := tests/system/attacks/test_attacks.py tests/system/attacks/test_payloads.py tests/system/faults/test_router_chain.py

$(ZENOHD):
	cargo install --quiet --locked zenohd --version $(ZENOHD_VERSION) --root $(ZENOHD_ROOT) \
		--no-default-features --features zenoh/transport_tcp,zenoh/transport_tls,zenoh/auth_usrpwd

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.ceilings

docs: install ## the documentation site in site/, with all links checked; open site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

reference: install ## the pages of docs/ that are written from the code
	$(BIN)/python -m tests.reference_pages

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: install ## writes docs/figures/bench.json, fails if a bound is missed that is no known miss (ARGS="motion tasks" for some)
	$(BIN)/python -m tests.bench $(ARGS)

figures: install ## the tables of the pages, from docs/figures/bench.json
	$(BIN)/python -m tests.bench.tables

soak: install ## kill -9, 200 times the coordinator and 100 times an agent of a live team: a quarter of an hour
	$(BIN)/python -m tests.system.soak --of coordinator --kills 200 $(ARGS)
	$(BIN)/python -m tests.system.soak --of agent --kills 100 $(ARGS)

endurance: install ## a live team of eight with tasks for half an hour: memory, descriptors and threads of each process (ARGS="--minutes 480")
	$(BIN)/python -m tests.system.endurance $(ARGS)

mutants: install ## break the code on purpose, 400 times, and list what no test notices: about half an hour
	$(BIN)/python -m tests.mutation $(ARGS)

clean:
	rm -rf $(VENV) build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
