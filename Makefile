# Every target works in a fresh clone: the first one that needs it runs the set-up.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
# one thread per process: two test workers share two cores, and timings mean one core
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: setup demo test test-long lint bench docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml tools/setup.sh tools/check_system.py
	PYTHON="$(PYTHON)" bash tools/setup.sh
	@touch $@

demo: $(STAMP)
	$(BIN)/python examples/demo.py

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist worksteal

test-long: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m pytest -m long

bench: $(STAMP)
	$(ONE_THREAD) $(BIN)/python benchmarks/kernels.py
	$(ONE_THREAD) $(BIN)/python benchmarks/step.py
	$(ONE_THREAD) $(BIN)/python benchmarks/contact.py
	$(ONE_THREAD) $(BIN)/python benchmarks/bodies.py
	$(ONE_THREAD) $(BIN)/python benchmarks/jointed.py
	$(ONE_THREAD) $(BIN)/python benchmarks/refinement.py
	$(ONE_THREAD) $(BIN)/python benchmarks/stability.py
	$(ONE_THREAD) $(BIN)/python benchmarks/skip.py
	$(ONE_THREAD) $(BIN)/python benchmarks/substeps.py
	$(ONE_THREAD) $(BIN)/python benchmarks/scaling.py
	$(ONE_THREAD) $(BIN)/python benchmarks/peers.py
	$(ONE_THREAD) $(BIN)/python benchmarks/wall.py
	$(ONE_THREAD) $(BIN)/python benchmarks/precision.py

docs: $(STAMP)
	$(BIN)/python tools/api_table.py docs/api.md
	$(ONE_THREAD) $(BIN)/python tests/verify/test_combinations.py docs/combinations.md
	$(ONE_THREAD) $(BIN)/python tools/contact_pictures.py docs
	$(ONE_THREAD) $(BIN)/python tools/contact_study.py

clean:
	rm -rf .venv out build *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
