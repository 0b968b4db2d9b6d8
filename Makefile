# What a person types. Every target sets up what it needs; `make` alone lists them.

ARGS ?=
PYTHON ?= $(or $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
            $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
            && echo $$p && break; done),python3)
UV ?= $(firstword $(shell command -v uv 2>/dev/null) $(wildcard .venv/bin/uv))
BIN := .venv/bin
STAMP := .venv/.made-from-lock
CODE := $(wildcard forcemesh common control controller identification tuning services sim launch cli bench examples tests tools)
LOCK := pip compile -q --universal --generate-hashes --no-emit-index-url \
        --custom-compile-command "make lock" pyproject.toml
PART := --no-annotate --extra build -c requirements.lock

# A python asked for by name replaces a .venv that was made with another one.
ifneq ($(filter command environment,$(firstword $(origin PYTHON))),)
ifneq ($(shell $(PYTHON) -V 2>&1 || true),$(shell $(BIN)/python -V 2>&1 || true))
.PHONY: $(STAMP)
endif
endif

.DEFAULT_GOAL := help
.PHONY: help setup demo test check totals format nightly bench docs up down compose-test pki lock clean

help: ## list these targets
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/:[^#]*## */\t/' | expand -t 14

setup: $(STAMP) ## make .venv from the lock (once; again when the lock changes)

$(STAMP): requirements.lock pyproject.toml
	@tools/setup.sh "$(PYTHON)"
	@touch $@

demo: setup ## press the simulated arm on a plate and let the force go to zero: ARGS="--force 20"
	@$(BIN)/forcemesh demo $(ARGS)

test: setup ## run every test, with CI=1 also the coverage of what decides about motion: ARGS="-k packet"
	@PYTHON=$(BIN)/python tools/test.sh $(ARGS)

check: setup ## lint, format, types, import contracts, sizes, doubles, cycles, links, totals
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/mypy $(CODE)
	@PATH="$(CURDIR)/$(BIN):$$PATH" lint-imports
	@$(BIN)/python -m tools.check
	@$(BIN)/python -m tools.totals

totals: setup ## lines, tokens, constants, tests and words of each folder, compared with tools/totals.txt: ARGS=--write
	@$(BIN)/python -m tools.totals $(ARGS)

format: setup ## let ruff format and fix what it can
	@$(BIN)/ruff format $(CODE)
	@$(BIN)/ruff check --fix $(CODE)

nightly: setup ## run what is too long for CI, on this commit; goes on where it stopped: ARGS="chaos soak", ARGS=--list
	@$(BIN)/python -m tools.nightly $(ARGS)

bench: setup ## measure what the pages state: ARGS="force --quick", ARGS=--help
	@$(BIN)/python -m bench $(ARGS)

docs: setup ## write the generated pages; into out/ the wheel of the library and the components of the image (CycloneDX)
	@mkdir -p out
	@$(BIN)/python -m tools.pages
	@$(BIN)/python -m tools.cli_page
	@cd forcemesh && ../$(BIN)/python -m hatchling build -t wheel -d ../out
	@$(BIN)/cyclonedx-py requirements requirements-panel.lock --pyproject pyproject.toml --output-reproducible \
	  --sv 1.6 --of JSON -o out/sbom.cdx.json && echo out/sbom.cdx.json

PROFILE ?=
ALL := --profile emulated --profile real
UP = $(COMPOSE)$(if $(PROFILE), --profile $(PROFILE))
KEEPER = $(or $(PROFILE),sim)
COMPOSE ?= $(shell docker compose version >/dev/null 2>&1 && echo docker compose || echo docker-compose)

up: ## bring the simulated cell up in containers; PROFILE=real CELL=my-cell.yaml yours in its place, PROFILE=emulated
	@$(UP) up -d --build $(ARGS)
	@$(UP) exec -T $(KEEPER)-cell python -m common.bus.profile_label check $(KEEPER)

down: ## take the containers down, of whichever profile
	@$(COMPOSE) $(ALL) down $(ARGS)

compose-test: setup ## build the images, bring the containers up, break and attack them (77: no engine): ARGS="--profile sim"
	@$(BIN)/python -m tests.compose $(ARGS)

pki: setup ## make the certificates of the bus and tell docker compose (.env) where they are: ARGS="--host labpc"
	@$(BIN)/forcemesh pki init --env .env $(ARGS)

lock: ## write the locks anew from pyproject.toml (needs uv): ARGS=--upgrade takes newer versions
	@test -n "$(UV)" || { echo "make lock needs uv: $(BIN)/python -m pip install uv" >&2; exit 1; }
	@$(UV) $(LOCK) $(ARGS) --all-extras -o requirements.lock
	@$(UV) $(LOCK) $(PART) --extra recorder --extra robotiq --extra bota -o requirements-control.lock
	@$(UV) $(LOCK) $(PART) --extra sim -o requirements-sim.lock
	@$(UV) $(LOCK) $(PART) --extra cli --extra robotiq --extra bota -o requirements-panel.lock

clean: ## remove .venv, caches and what runs have written
	@rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .run out
	@find $(CODE) -name __pycache__ -type d -prune -exec rm -rf {} +
