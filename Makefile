# What a person types. Every target sets up what it needs; `make` alone lists them.

ARGS ?=
PYTHON ?= $(or $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
            $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
            && echo $$p && break; done),python3)
UV ?= $(firstword $(shell command -v uv 2>/dev/null) $(wildcard .venv/bin/uv))
BIN := .venv/bin
STAMP := .venv/.made-from-lock
FUZZ_SECONDS ?= 60
CODE := $(wildcard forcemesh common controller identification tuning services sim launch cli bench examples tests tools)
LOCK := pip compile -q --universal --generate-hashes --no-emit-index-url \
        --custom-compile-command "make lock" pyproject.toml

# A python asked for by name replaces a .venv that was made with another one.
ifneq ($(filter command environment,$(firstword $(origin PYTHON))),)
ifneq ($(shell $(PYTHON) -V 2>&1 || true),$(shell $(BIN)/python -V 2>&1 || true))
.PHONY: $(STAMP)
endif
endif

# The tests of the modules that `make coverage` measures, without those that only repeat their ways.
COVERED_BY = $(addprefix tests/unit/,services/arbiter services/gateway services/regulator \
  services/wrench common/motion common/runtime common/config controller/test_packet.py controller/test_plain.py \
  tuning/test_measured_range.py tuning/test_gain_rule.py launch/test_virtual_cell_speed.py repository/test_input_bounds.py) \
  $(wildcard tests/unit/forcemesh/test_*.py) tests/contract/test_stop_contract.py tests/scenario/test_controller_error_virtual.py
NO_NEW_BRANCH := mutation_is_detected or mutation_of_the_gateway or gate_breaks_a_rule or dead_end or every_fault_of_the_sensor \
  or judge_finds or no_command_gets_past or wall_that_vanishes or four_times_stiffer \
  or stall_at_first_touch or stall_while_holding or number_survives_the_dump or verbs_open

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-long test-bringup test-browser test-subscribers coverage check format readme bench bench-chain bench-tcp bench-payload bench-force bench-forecast chaos chaos-full chaos-network chaos-flood chaos-clocks soak soak-sensor flips nightly mutate mutate-program fuzz fuzz-commands hostile pki up down sbom compose-test wheel lock clean

help: ## list these targets
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/:[^#]*## */\t/' | expand -t 10

setup: $(STAMP) ## make .venv from the lock (once; again when the lock changes)

$(STAMP): requirements.lock pyproject.toml
	@tools/setup.sh "$(PYTHON)"
	@touch $@

demo: setup ## press the simulated arm on a plate and let the force go to zero: ARGS="--force 20"
	@$(BIN)/forcemesh demo $(ARGS)

test: setup ## run every test, then show the largest files and functions: ARGS="-k packet"
	@PYTHON=$(BIN)/python tools/test.sh $(ARGS)
	@$(BIN)/python -m tools.sizes

test-long: setup ## run the tests that make test leaves out
	@LONG=1 PYTHON=$(BIN)/python tools/test.sh $(ARGS)

test-bringup: setup ## walk the whole bring-up against the emulator, with two planted mistakes: five minutes
	@$(BIN)/python -m pytest -q -m ladder tests/scenario/test_bringup_processes.py $(ARGS)

test-axes: setup ## a thousand drawn tasks per axis, in every frame and on every loop host: eight minutes
	@$(BIN)/python -m pytest -q -m axes -n auto -o timeout=600 tests/scenario/test_force_axes.py $(ARGS)

test-browser: setup ## drive the panel in /usr/bin/chromium against a simulated cell; pictures into out/
	@$(BIN)/python -m pytest -q -m browser tests/browser $(ARGS)

test-subscribers: setup ## run the subscribers in other languages against a hub (77: some tools are missing); Rust builds for minutes
	@$(BIN)/python -m tools.subscribers_test

coverage: setup ## take every branch of the modules that decide about motion: the list is in pyproject.toml
	@CI=1 $(BIN)/python -m pytest -q -n auto -o timeout=600 --hypothesis-profile=branches -m "not (realtime or processes or long)" -k "not ($(NO_NEW_BRANCH))" \
	  --cov --cov-report=term $(COVERED_BY) $(ARGS)

check: setup ## lint, format, types, import contracts, words, sizes, structure
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/mypy $(CODE)
	@PATH="$(CURDIR)/$(BIN):$$PATH" lint-imports
	@$(BIN)/python -m tools.words
	@$(BIN)/python -m tools.sizes
	@$(BIN)/python -m tools.structure

format: setup ## let ruff format and fix what it can
	@$(BIN)/ruff format $(CODE)
	@$(BIN)/ruff check --fix $(CODE)

readme: setup ## write what is generated from the code: docs/bus.md and other pages, secrets of docker-compose.yml
	@$(BIN)/python -m tools.bus_page
	@$(BIN)/python -m tools.compose_secrets
	@$(BIN)/python -m tools.faults_page
	@$(BIN)/python -m tools.arbitration_page
	@$(BIN)/python -m tools.schema_page
	@$(BIN)/python -m tools.cli_page
	@$(BIN)/python -m tools.packet_page

bench: setup ## measure the figures of docs/demo.md
	@$(BIN)/python -m bench $(ARGS)

bench-chain: setup ## the cell's chain compared with bare forwarding processes: ARGS="--full --write" makes docs/chain.md
	@$(BIN)/python -m bench.chain $(ARGS)

bench-tcp: setup ## play the demo over TCP in every combination: ARGS=--write makes docs/over-tcp.md
	@$(BIN)/python -m bench.over_tcp $(ARGS)

bench-payload: setup ## payload identification beside the published ones: ARGS="recording.csv" adds it, ARGS=--quick
	@$(BIN)/python -m bench.payload $(ARGS)

bench-force: setup ## how well laws release, hold, find and follow a force: ARGS=--quick, --json, --paths or --axes alone; --write makes docs/force*.md
	@$(BIN)/python -m bench.force $(ARGS)

bench-forecast: setup ## forecasts of 200 drawn jobs compared with what happens: ARGS=--write makes docs/forecast.md, --map the map
	@$(BIN)/python -m bench.forecast $(ARGS)

chaos: setup ## kill, freeze and starve every process of a moving cell, also two at once, see that it holds: ARGS="--seed 7"
	@$(BIN)/python -m tests.chaos $(ARGS)

chaos-full: setup ## the same twenty times each, about 90 minutes, goes on where it was interrupted; writes docs/chaos.md
	@$(BIN)/python -m tests.chaos --each 20 --journal out/chaos-full.jsonl --write $(ARGS)

chaos-network: setup ## pull, cut and slow the cables of a moving cell, in namespaces (root): ARGS=--write
	@$(BIN)/python -m tests.chaos.network $(ARGS)

chaos-flood: setup ## freeze a viewer and flood the bus while the arm presses: nobody may be late
	@$(BIN)/python -m tests.chaos.flood $(ARGS)

chaos-clocks: setup ## let wall clocks jump and monotonic clocks differ while the arm presses (root)
	@$(BIN)/python -m tests.chaos.clocks $(ARGS)

soak: setup ## ten minutes of rounds at full rate: no growth, no leak, no false hold: ARGS="--minutes 1"
	@$(BIN)/python -m tests.chaos.soak $(ARGS)

soak-sensor: setup ## a sensor at 1 kHz over UDP for ten minutes: no record lost, few superseded: ARGS="--minutes 1"
	@$(BIN)/python -m bench.sensor_soak $(ARGS)

fuzz: setup ## look for inputs that break the readers, FUZZ_SECONDS=60 for each: ARGS=receiver
	@$(BIN)/python -m tests.fuzz --seconds $(FUZZ_SECONDS) $(ARGS)

fuzz-commands: setup ## let an evil arbiter say a million commands: ARGS="--messages 100000 gateway"
	@$(BIN)/python -m tests.fuzz.commands $(ARGS)

hostile: setup ## ten thousand hostile requests and messages to a running cell: ARGS="--count 500"
	@$(BIN)/python -m tools.hostile --up $(ARGS)
	@$(BIN)/python -m tools.playback

flips: setup ## spoil every digit of every report of the controller in turn, some hours
	@EVERY_FLIP=1 $(BIN)/python -m pytest -q -n auto -m long tests/contract/test_abuse_reports.py $(ARGS)

nightly: setup ## run what is too long for CI, on this commit; goes on where it stopped: ARGS="chaos soak", ARGS=--list
	@$(BIN)/python -m tools.nightly $(ARGS)

mutate: setup ## change single expressions of what decides about motion; no test may miss one: ARGS="--count 5"
	@$(BIN)/python -m tests.mutate $(ARGS)

mutate-program: setup ## the same with steps of the controller's program: ARGS="--count 200 --seed 2"
	@$(BIN)/python -m tests.mutate_program $(ARGS)

wheel: setup ## build the library that `pip install forcemesh` takes: out/forcemesh-*.whl
	@mkdir -p out && cd forcemesh && ../$(BIN)/python -m hatchling build -t wheel -d ../out

pki: setup ## make the certificates of the bus and tell docker compose (.env) where they are: ARGS="--host labpc"
	@$(BIN)/forcemesh pki init --env .env $(ARGS)

PROFILE ?=
ALL := --profile emulated --profile real
UP = $(COMPOSE)$(if $(PROFILE), --profile $(PROFILE))
KEEPER = $(or $(PROFILE),sim)
COMPOSE ?= $(shell docker compose version >/dev/null 2>&1 && echo docker compose || echo docker-compose)

up: ## bring the simulated cell up in containers; PROFILE=real CELL=my-cell.yaml yours in its place, PROFILE=emulated
	@$(UP) up -d --build $(ARGS)
	@$(UP) exec -T $(KEEPER)-cell python -m common.bus.profile_lock check $(KEEPER)

down: ## take the containers down, of whichever profile
	@$(COMPOSE) $(ALL) down $(ARGS)

sbom: setup ## write what the image is made of into out/sbom.cdx.json (CycloneDX)
	@mkdir -p out
	@$(BIN)/cyclonedx-py requirements requirements-run.lock --pyproject pyproject.toml --output-reproducible \
	  --sv 1.6 --of JSON -o out/sbom.cdx.json && echo out/sbom.cdx.json

compose-test: setup ## build the image, bring the containers up, break and attack them (77: no engine): ARGS="--profile sim"
	@$(BIN)/python -m tools.compose_test $(ARGS)

lock: ## write both locks anew from pyproject.toml (needs uv): ARGS=--upgrade takes newer versions
	@test -n "$(UV)" || { echo "make lock needs uv: $(BIN)/python -m pip install uv" >&2; exit 1; }
	@$(UV) $(LOCK) $(ARGS) --all-extras -o requirements.lock
	@$(UV) $(LOCK) --no-annotate --extra build --extra cli --extra robotiq --extra bota -c requirements.lock -o requirements-run.lock

clean: ## remove .venv, caches and what runs have written
	@rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .run out
	@find $(CODE) -name __pycache__ -type d -prune -exec rm -rf {} +
