# Everything starts here; nothing but Python 3.11, g++ and make is needed on the machine.

PYTHON ?= python3
BIN := .venv/bin

.PHONY: help setup scan test bitstream program boards netlist fuzz soak bench docs lock clean

help: ## list the targets (default)
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: .venv/ready ## the environment, in .venv, from requirements.lock

.venv/ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}: set PYTHON=...")'
	$(PYTHON) -m venv --clear .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

scan: setup ## scan the default scene with the virtual card: out/scan.ply, out/scan.png
	$(BIN)/python -m sim.demo out

test: setup ## all checks and tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -c 'from sim.core import library; library()' # compiled now, for tests have time limits
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

BUILD_OF = "$(BOARD)" --link "$(LINK)" --source "$(or $(SOURCE),pattern)"

bitstream: setup ## the bitstream of BOARD=name (LINK=uart or usb, SOURCE=, SERIAL=hex): build/name/top.bit
	@$(BIN)/python -m boards.build $(BUILD_OF) --serial "$(or $(SERIAL),1)"

program: bitstream ## load it into BOARD=name, with the same LINK=, SOURCE=, SERIAL=
	@$(BIN)/python -m boards.program $(BUILD_OF)

boards: setup ## the bitstreams of all boards, and the table in docs/boards/README.md
	@$(BIN)/python -m boards.table

netlist: setup ## Yosys's netlists of two cards, simulated beside what was written; a quarter of an hour
	$(BIN)/python -m pytest tests/boards/netlist.py

fuzz: setup ## fuzz for some ten minutes: a million damaged packets, a minute for each reader of files and bytes
	$(BIN)/python -m tests.fuzz.damage
	for target in decoder settings calibration recording; do \
	  $(BIN)/python -m tests.fuzz.targets $$target -max_total_time=60 || exit 1; \
	done
	$(BIN)/python -m tests.fuzz.gateware --seconds 60

soak: setup ## a hundred thousand frames through the virtual card, every loss accounted for
	$(BIN)/python -m tests.soak

bench: setup ## speed and accuracy beside their peers: a table and build/bench.json
	$(BIN)/python -m tests.bench

docs: setup ## render what is generated: docs/protocol.md, pages of the boards
	$(BIN)/python -m magtrak.protocol > docs/protocol.md
	$(BIN)/python -m boards.pages

lock: ## requirements.lock anew from pyproject.toml (needs uv)
	uv pip compile --quiet --universal --generate-hashes --python-version 3.11 --all-extras \
	  --custom-compile-command 'make lock' pyproject.toml -o requirements.lock

clean: ## remove what was built, not the environment
	rm -rf build out
