# Two commands: `make chase` runs a chase, `make test` checks the code. Each sets up .venv/ by itself, once.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: chase test docs check-python tag clean

chase: $(VENV)/.installed
	$(BIN)/swarmchase chase --controller paper

# The workers and the hundreds of processes that tests start read what the first of them has compiled.
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/.installed-dev
	@echo "== style" && $(BIN)/ruff format --check . && $(BIN)/ruff check .
	@echo "== tests, and types beside them"
	@(told=$$($(BIN)/mypy 2>&1); code=$$?; printf '\n== types\n%s\n' "$$told"; exit $$code) & types=$$!; \
	$(BIN)/python -m pytest -q -n 4 --dist loadfile --no-loadscope-reorder; tests=$$?; \
	wait $$types || { echo "== types are wrong: see above"; exit 1; }; \
	exit $$tests

# The documentation as a site: open site/index.html. Warnings are errors.
docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/.installed-docs
	$(BIN)/python -m mkdocs build --strict

$(VENV)/bin/python: | check-python
	@echo "== making a virtual environment in $(VENV)/"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "== installing swarmchase into $(VENV)/ (PyTorch is large: some minutes the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "== installing swarmchase and its test tools into $(VENV)/ (PyTorch is large: some minutes the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(VENV)/.installed
	@echo "== installing what makes the site of the documentation"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@

check-python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "swarmchase needs Python 3.11 or newer, and $(PYTHON) is " + sys.version.split()[0] + "; give another with: make PYTHON=python3.12 ...")'

# The version stands in the package alone: the tag is made of it.
tag:
	@version=$$(sed -n 's/^__version__ = "\(.*\)"$$/\1/p' src/swarmchase/__init__.py); \
	grep -q "^## $$version - " CHANGELOG.md || { echo "CHANGELOG.md has no section of $$version"; exit 1; }; \
	grep -q "^version: $$version$$" CITATION.cff || { echo "CITATION.cff is of another version than $$version"; exit 1; }; \
	test -z "$$(git status --porcelain)" || { echo "commit first: git status is not clean"; exit 1; }; \
	git tag -a "v$$version" -m "swarmchase $$version"

clean:
	rm -rf $(VENV)
