# Every command sets up what it needs. `make demo` and `make test` are enough for a start.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: setup demo test check docs bench serve fmt clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt docker/system-libraries.sh
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "boxlift needs Python 3.11 or newer; name one with: make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	@sh docker/system-libraries.sh $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt hatchling editables
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[dev]'
	@touch $@

demo: $(READY)
	$(BIN)/boxlift demo --out demo

test: check
	@sh tests/chromium.sh
	$(BIN)/pytest -n 2 --dist loadfile

check: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

docs: $(READY)
	PYTHONPATH=benchmarks $(BIN)/python scripts/make_documentation.py
	$(BIN)/jupyter execute --inplace --NotebookClient.record_timing=False docs/notebook.ipynb

fmt: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

serve: $(READY)
	$(BIN)/boxlift serve

bench: $(READY)
	$(BIN)/python benchmarks/fit.py
	$(BIN)/python benchmarks/ablation.py
	$(BIN)/python benchmarks/accurate.py --sequences
	$(BIN)/python benchmarks/scaled_world.py
	$(BIN)/python benchmarks/prompts.py
	$(BIN)/python benchmarks/presets.py
	$(BIN)/python benchmarks/rig_check.py
	$(BIN)/python benchmarks/evaluator.py
	$(BIN)/python benchmarks/label.py
	$(BIN)/python benchmarks/label_http.py
	$(BIN)/python benchmarks/detector.py
	$(BIN)/python benchmarks/detect_http.py
	$(BIN)/python benchmarks/backbones.py
	$(BIN)/python benchmarks/monocular_cameras.py
	$(BIN)/python benchmarks/load.py --soak 600
	$(BIN)/python benchmarks/faults.py
	$(BIN)/python benchmarks/peer.py
	$(BIN)/python benchmarks/micro_batches.py
	$(BIN)/python benchmarks/dashboard.py
	$(BIN)/python benchmarks/review_page.py
	$(BIN)/python benchmarks/merging.py
	$(BIN)/python benchmarks/odometry.py
	$(BIN)/python benchmarks/tracking.py
	$(BIN)/python benchmarks/tracking.py real --prompts detector
	for what in time memory; do $(BIN)/python benchmarks/tracking_cost.py $$what || exit 1; done
	$(BIN)/python benchmarks/kills.py --frames 900
	$(BIN)/python benchmarks/kills.py --engine ray --frames 900
	for what in pace engines bad memory ledger listing; do $(BIN)/python benchmarks/dataset_runs.py $$what || exit 1; done
	$(BIN)/python benchmarks/fuzz_decoders.py
	$(BIN)/python benchmarks/fuzz_decoders.py --large
	$(BIN)/python benchmarks/fuzz_api.py

clean:
	rm -rf $(VENV) demo dist
