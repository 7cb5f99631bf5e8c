# `make setup` is the shared first step; `make demo` and `make test` do everything on a fresh machine.
PYTHON ?= python3
# On a machine with an NVIDIA GPU: make setup TORCH=torch EXTRAS=dev,cuda
TORCH ?= torch==2.13.0
EXTRAS ?= dev
# LOCKED=1 installs the versions of constraints.txt, which all tests pass with, LOCKED=lowest those of
# constraints-lowest.txt; else the newest.
LOCKED ?=
LOCK := $(if $(filter lowest,$(LOCKED)),constraints-lowest.txt,constraints.txt)
VENV := .venv
BIN := $(VENV)/bin
# Python compiles the modules that it imports; compiling all of them takes half of pip's time.
INSTALL := $(BIN)/pip install --quiet --no-compile
PACKAGES := $(VENV)/.packages-installed
KERNELS := $(VENV)/.kernels-compiled
DEMO_OUT ?= runs/demo
SAMPLE := recipes/demo/partial.ply --prompt "$$(cat recipes/demo/prompt.txt)"

# Containers often tell Python to keep no compiled modules; tests start hundreds of processes.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: setup demo test suite lint bench clean FORCE

setup: $(KERNELS)

$(PACKAGES): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) "$(TORCH)"
	$(INSTALL) $(if $(LOCKED),--constraint $(LOCK)) --editable ".[$(EXTRAS)]"
	touch $(PACKAGES)

$(KERNELS): $(PACKAGES)
	@echo "Compiling kernels, for which the first completion would wait"
	rm -rf $(VENV)/first $(VENV)/steps
	-$(BIN)/gscomplete complete $(SAMPLE) --out $(VENV)/first > /dev/null
	-$(BIN)/gscomplete complete $(SAMPLE) --preset distill --steps 2 --out $(VENV)/steps > /dev/null
	rm -rf $(VENV)/first $(VENV)/steps
	touch $(KERNELS)

# What is asked for by name is installed whatever is there already.
ifneq ($(filter command environment,$(origin TORCH) $(origin EXTRAS)),)
$(PACKAGES): FORCE
endif
FORCE:

# A partial object made by our own generator (recipes/demo), completed with the embedded prior.
demo: setup
	rm -rf $(DEMO_OUT)
	$(BIN)/gscomplete complete $(SAMPLE) --out $(DEMO_OUT)
	@echo "Look at $(DEMO_OUT)/preview.png and $(DEMO_OUT)/turntable.webp"

lint: $(PACKAGES)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Types are checked against the stubs of the newest packages, while kernels are compiled and tests run.
test:
	$(MAKE) --jobs=2 --no-print-directory $(if $(filter lowest,$(LOCKED)),,lint) suite

# Tests of a file share what its fixtures make, so a file goes to one process.
suite: setup
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

bench: setup
	$(BIN)/python -m recipes.benchmarks.renderer

clean:
	rm -rf $(VENV) $(DEMO_OUT) build *.egg-info
