PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: run test docs clean

run: $(VENV)/installed
	$(BIN)/deepfsi compare -o runs/digits
	$(BIN)/deepfsi design --photons 1e4 --masks 16 --light free-dwell --rails single --looks 4 \
	  --hold-out 287 -o runs/digits/looks.safetensors
	$(BIN)/deepfsi page runs/digits/looks.safetensors -o runs/digits/page.html

test: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n logical --dist worksteal

docs: $(VENV)/docs
	$(BIN)/sphinx-build --fail-on-warning --keep-going --jobs auto docs docs/_build/html
	$(BIN)/python docs/check_site.py docs/_build/html

$(VENV)/torch: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt pip
	$(BIN)/pip install --quiet --no-compile -c constraints.txt torch
	touch $@

$(VENV)/installed: $(VENV)/torch
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e . --group dev
	touch $@

$(VENV)/docs: $(VENV)/torch
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e . --group docs
	touch $@

clean:
	rm -rf $(VENV) docs/_build docs/generated runs .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
