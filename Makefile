PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

unexport PYTHONDONTWRITEBYTECODE # compiled anew, the imports of torch alone take each process 3 s

# each folder that a test makes costs milliseconds on some disks, and nothing in memory; your TMPDIR stays
IN_MEMORY := $(if $(TMPDIR),,$(shell df --output=avail /dev/shm 2>/dev/null | awk '$$1 + 0 > 8e6 {print "TMPDIR=/dev/shm"}'))

.PHONY: run test quick static pytest-test pytest-quick docs clean

run: $(VENV)/package
	$(BIN)/deepfsi compare --camera paper -o runs/paper
	$(BIN)/deepfsi compare --camera dmd --designs impulse,raster,truncated-hadamard,pca,deepfsi,adaptive \
	  -o runs/dmd
	$(BIN)/deepfsi design --camera dmd --design adaptive --photons 1e4 --masks 16 --cap 2 \
	  -o runs/dmd/adaptive.safetensors
	$(BIN)/deepfsi page runs/dmd/adaptive.safetensors -o runs/dmd/page.html

test quick: $(VENV)/installed
	$(MAKE) --jobs 2 static pytest-$@

static: # one process, which leaves the other cores to pytest
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

pytest-test:
	OMP_NUM_THREADS=1 $(IN_MEMORY) $(BIN)/pytest -n logical --dist worksteal

pytest-quick:
	OMP_NUM_THREADS=1 $(IN_MEMORY) $(BIN)/pytest -n logical --dist worksteal tests/golden tests/test_house.py

docs: $(VENV)/docs
	$(BIN)/sphinx-build --fail-on-warning --keep-going --jobs auto docs docs/_build/html
	$(BIN)/python docs/check_site.py docs/_build/html

$(VENV)/torch: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt pip
	$(BIN)/pip install --quiet --no-compile -c constraints.txt torch
	touch $@

$(VENV)/package: $(VENV)/torch # what `make run` needs: half of the time of all
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e .[design]
	touch $@

$(VENV)/installed: $(VENV)/torch
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e . --group dev
	touch $@

$(VENV)/docs: $(VENV)/torch
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e . --group docs
	touch $@

clean:
	rm -rf $(VENV) docs/_build docs/generated runs .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
