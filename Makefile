# Every command sets up what it needs, from nothing but python3 (3.11 or newer) and make. Start with `make help`.

PYTHON ?= python3
VENV ?= .venv
# Options for pytest, as in: make test ARGS="-k registry"
ARGS ?=
# Processes of pytest: as many as there are cores, but no more than this.
WORKERS ?= 4

PLUGIN_PROJECTS := $(wildcard plugins/*/pyproject.toml)
PLUGINS := $(patsubst %/pyproject.toml,%,$(PLUGIN_PROJECTS))
PLUGIN_PACKAGES := $(patsubst %/__init__.py,%,$(wildcard plugins/*/gem_*/__init__.py))
BENCHMARKS := $(filter-out benchmarks/harness.py,$(wildcard benchmarks/*.py))
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest -q -n auto --maxprocesses $(WORKERS) --dist worksteal
# No build isolation: hatchling comes pinned from constraints.txt, and a second install works offline. setuptools builds
# the dependencies that come as source alone (chess).
INSTALL := $(BIN)/python -m pip install --quiet --no-build-isolation -c constraints.txt

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1
unexport PYTHONPATH PYTHONHOME
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

# $(call say,TEXT) announces a step; $(call quietly,COMMAND) shows a command's output only when it fails.
say = @echo "==> $(1)"
quietly = @log=$$(mktemp) && if $(1) >"$$log" 2>&1; then rm -f "$$log"; \
	else cat "$$log" >&2; rm -f "$$log"; exit 1; fi

.PHONY: help
help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1|\2/p' Makefile | while IFS='|' read -r name text; do \
		printf '  %-20s %s\n' "$$name" "$$text"; done
	@echo "Another interpreter, in an environment of its own: make test PYTHON=python3.13 VENV=.venv-3.13"

.PHONY: demo
demo: $(VENV)/.demo ## watch built-in agents play three games, and write what they did to runs/
	$(call say,a random agent plays three games)
	@$(BIN)/gem run game:GuessTheNumber-v0 game:Mastermind-v0-easy game:TowerofHanoi-v0-easy \
		--agent random --episodes 1000 --num-envs 8 --seed 1 --out runs/demo-random.jsonl --overwrite
	$(call say,a solver plays GuessTheNumber by bisection)
	@$(BIN)/gem run game:GuessTheNumber-v0 \
		--agent bisect --episodes 1000 --num-envs 8 --seed 1 --out runs/demo-bisect.jsonl --overwrite

.PHONY: test
test: $(VENV)/.dev ## run the tests of the core and of each plugin, each contract by its cheapest case
	$(call say,running the tests)
	@$(PYTEST) $(ARGS) tests $(wildcard plugins/*/tests)

.PHONY: test-core
test-core: $(VENV)/.dev ## run the core's tests alone, as on another Python
	@$(PYTEST) $(ARGS) tests

.PHONY: test-thorough
test-thorough: $(VENV)/.dev ## run all of them: whole matrices, real engines, and each plugin in isolation
	$(call say,running all tests)
	@$(PYTEST) --thorough $(ARGS) tests $(wildcard plugins/*/tests)
	@$(MAKE) test-isolated

.PHONY: test-root
test-root: $(VENV)/.dev ## run, as root, the tests of what root's rights change
	@$(PYTEST) -m root -p no:cacheprovider $(ARGS) $(wildcard plugins/*/tests)

.PHONY: test-isolated
test-isolated: $(VENV)/.dev ## run each plugin's tests with only the core and itself installed
	@$(BIN)/python scripts/isolated_tests.py --venvs $(VENV)-isolated $(PLUGINS)

.PHONY: lint
lint: $(VENV)/.dev ## check format, style, types and declared dependencies
	$(call say,ruff format)
	@$(BIN)/ruff format --quiet --diff .
	$(call say,ruff check)
	@$(BIN)/ruff check --quiet .
	$(call say,mypy --strict)
	@$(BIN)/mypy gem_core $(PLUGIN_PACKAGES) scripts benchmarks
	$(call say,declared dependencies)
	@deptry="$$PWD/$(BIN)/deptry"; for project in . $(PLUGINS); do \
		found=$$(cd "$$project" && "$$deptry" --no-ansi . 2>&1) || { echo "$$found" | sed "s|^|$$project: |"; exit 1; }; done

.PHONY: format
format: $(VENV)/.dev ## format the code, and mend what ruff can mend
	@$(BIN)/ruff check --quiet --fix-only .
	@$(BIN)/ruff format .

.PHONY: docs
docs: $(VENV)-docs/.installed ## build the documentation into site/, and check every link of it
	$(call say,building the documentation)
	@NO_MKDOCS_2_WARNING=1 $(VENV)-docs/bin/mkdocs build --strict
	@$(PYTHON) scripts/check_site.py site

.PHONY: docs-pages
docs-pages: $(VENV)/.dev ## write the pages of the reference that are made from commands and packages
	@$(BIN)/python scripts/command_reference.py
	@$(BIN)/python scripts/api_reference.py

.PHONY: wheels
wheels: $(VENV)/.demo ## build the wheel of every distribution into dist/
	$(call say,building gem-core and $(notdir $(PLUGINS)))
	@rm -rf dist
	$(call quietly,$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation -w dist . $(addprefix ./,$(PLUGINS)))
	@ls dist

.PHONY: bench
bench: $(VENV)/.installed $(VENV)-peer/.installed $(VENV)-inspect/.installed ## measure beside gem-llm and inspect_ai; prints ratios
	@for script in $(BENCHMARKS); do \
		$(BIN)/python "$$script" --ours $(BIN)/python --peer $(VENV)-peer/bin/python || exit 1; done

.PHONY: trainers
trainers: ## run each file of examples/trainers with its framework, in environments of their own (ARGS="trl_rollout …")
	@$(PYTHON) scripts/trainers.py $(ARGS)

.PHONY: constraints
constraints: ## pin the newest versions in constraints.txt (PYTHONS="python3.11 python3.12 …")
	@$(PYTHON) scripts/constraints.py $(or $(PYTHONS),$(PYTHON))

.PHONY: clean
clean: ## remove all that these commands made, but for runs/
	@if [ -d .venv-docker ]; then scripts/docker_engine.sh stop; fi
	rm -rf .venv-docker $(VENV) $(VENV)-isolated $(VENV)-peer $(VENV)-inspect $(VENV)-docs .venv-trainers .venv-mcp build dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The environments. A stamp file says that one is up to date; what it was made from stands behind the colon.

# An environment belongs to one interpreter and one folder: with another, it is made anew.
MADE_FROM := $(PYTHON) in $(CURDIR)
ifneq "$(MADE_FROM)" "$(shell cat $(VENV)/.made 2>/dev/null)"
.PHONY: $(VENV)/.made
endif

$(VENV)/.made:
	$(call say,making $(VENV))
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo \
		"error: '$(PYTHON)' is not Python 3.11 or newer; name one, as in: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo \
		"error: '$(PYTHON)' lacks the modules venv and ensurepip; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	$(call quietly,$(PYTHON) -m venv --clear $(VENV))
	@printf '%s\n' "$(MADE_FROM)" > $@

# What a first look needs; other plugins bring engines that take their time to install.
$(VENV)/.demo: $(VENV)/.made pyproject.toml constraints.txt plugins/gem-games/pyproject.toml
	$(call say,installing gem-core and gem-games)
	$(call quietly,$(INSTALL) hatchling editables setuptools)
	$(call quietly,$(INSTALL) -e . -e plugins/gem-games)
	@touch $@

$(VENV)/.installed: $(VENV)/.demo $(PLUGIN_PROJECTS)
	$(call say,installing $(notdir $(PLUGINS)))
	$(call quietly,$(INSTALL) -e . $(addprefix -e ,$(PLUGINS)))
	@touch $@

$(VENV)/.dev: $(VENV)/.installed requirements-dev.txt
	$(call say,installing the development tools)
	$(call quietly,$(INSTALL) -r requirements-dev.txt)
	@# reasoning-gym needs pycosat, which comes as source in C alone.
	@$(INSTALL) "gem-math[reasoning-gym]" >/dev/null 2>&1 || echo \
		"note: pycosat cannot be built here (a C compiler and the headers of Python?); the tests of rg:* are skipped"
	@touch $@

$(VENV)-docs/.installed: $(VENV)/.made requirements-docs.txt constraints.txt
	$(call say,installing what builds the documentation)
	$(call quietly,$(PYTHON) -m venv --clear $(VENV)-docs)
	$(call quietly,$(VENV)-docs/bin/python -m pip install --quiet -c constraints.txt -r requirements-docs.txt)
	@touch $@

$(VENV)-peer/.installed: $(VENV)/.made benchmarks/requirements-peer.txt
	$(call say,installing the peer to measure against)
	$(call quietly,$(PYTHON) -m venv --clear $(VENV)-peer)
	$(call quietly,$(VENV)-peer/bin/python -m pip install --quiet -r benchmarks/requirements-peer.txt)
	@touch $@

$(VENV)-inspect/.installed: $(VENV)/.made benchmarks/requirements-inspect.txt
	$(call say,installing inspect_ai and openai to measure against)
	$(call quietly,$(PYTHON) -m venv --clear $(VENV)-inspect)
	$(call quietly,$(VENV)-inspect/bin/python -m pip install --quiet -r benchmarks/requirements-inspect.txt)
	@touch $@
