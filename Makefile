# Everything runs in .venv, which the first call makes. Needs Python 3.11 or newer.
#
#   make demo      a sample character walks: a GLB and an MP4 in demo/
#   make quick     the core of each room: a minute of a processor core, no network
#   make test      the tests
#   make docs      the documentation with the API, in build/docs
#   make fuzz      broken files for all readers: COUNT=100000 of them, from seed FIRST=0 on
#   make studio    build the studio's page and the view of .html again (needs npm, and only if you change them)
#   make stops     kills commands at TIMES=20 random file events and interrupts them at as many moments, and looks what is left
#   make soak      mixed work in one process for MINUTES=60, whose memory must not grow
#   make browser   the tests of the studio's page in Chromium
#   make lint      ruff and mypy
#   make format    let ruff rewrite the sources
#   make install   the set-up for using Bunraku
#   make develop   the set-up for working on it: also what tests, lint and trainings need
#   make wheel     the package in dist/
#   make clean     remove what the above wrote, but for .venv

PYTHON ?= python3
TORCH ?= torch==2.13.0
# Which build of PyTorch `make develop` takes: "auto" asks uv for the one that fits the graphics card that is there, and for the one without CUDA where there is none;
# "cpu", or another name that uv knows, asks for that; "pip" takes what pip finds, as its own settings (an index of yours, say) tell it.
TORCH_BACKEND ?= auto
# A file of versions to take, such as requirements.lock, which holds those that were tested together; tools/make_lock.py writes it.
LOCK ?=
PROMPT ?= a person walks forward
SAMPLE ?= person
COUNT ?= 100000
FIRST ?= 0
MINUTES ?= 60
TIMES ?= 20

BIN := .venv/bin
READY := .venv/.installed
DEVELOP := .venv/.developing

.DEFAULT_GOAL := help
# Python compiles what it imports when it first does; compiling all that is installed would take 200 MB and half the time.
PIP := .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile
LOCKED := $(if $(LOCK),--constraint $(LOCK))

.PHONY: help install develop demo studio quick test docs browser fuzz stops soak lint format wheel clean

help:
	@sed -n 's/^#   //p' Makefile

install: $(READY)

develop: $(DEVELOP)

# A broken or foreign .venv shows itself here and is made again.
.venv/pyvenv.cfg:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "bunraku needs Python 3.11 or newer and '$(PYTHON)' is not; name one with: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 2; }
	$(PYTHON) -m venv .venv || { echo "could not make .venv; on Debian and Ubuntu first install python3-venv" >&2; rm -rf .venv; exit 2; }

# For trainings torch comes first and pinned: what PyPI has for Linux brings gigabytes of CUDA that a processor never uses. Its wheel carries its own tests, programs
# of 130 MB that nothing loads; they go.
.venv/.torch: .venv/pyvenv.cfg
	@if [ '$(TORCH_BACKEND)' != pip ] && $(PIP) 'uv>=0.7' && UV_HTTP_TIMEOUT=30 VIRTUAL_ENV='$(CURDIR)/.venv' \
		$(BIN)/uv pip install --quiet --torch-backend='$(TORCH_BACKEND)' '$(TORCH)'; then :; else \
		echo "taking the build of PyTorch that pip finds; without a setting of yours that is CUDA's on Linux" >&2; $(PIP) '$(TORCH)'; fi
	@$(BIN)/python -m pip uninstall --quiet --disable-pip-version-check --yes uv
	@rm -rf $(foreach name,test bin/test_* bin/*Test bin/protoc*,.venv/lib/python3.*/site-packages/torch/$(name))
	@touch $@

$(READY): .venv/pyvenv.cfg pyproject.toml
	$(PIP) $(LOCKED) -e .
	@touch $@

$(DEVELOP): .venv/.torch pyproject.toml
	$(PIP) $(LOCKED) -e '.[dev]'
	@touch $@ $(READY)

demo: $(READY) demo/$(SAMPLE).glb
	@$(BIN)/bunraku animate demo/$(SAMPLE).glb "$(PROMPT)" --seconds 4 -o demo/$(SAMPLE)-animated.glb --preview demo/$(SAMPLE)-animated.mp4
	@test -s demo/$(SAMPLE)-animated.glb && test -s demo/$(SAMPLE)-animated.mp4
	@echo "animation: demo/$(SAMPLE)-animated.glb"
	@echo "video:     demo/$(SAMPLE)-animated.mp4"

demo/$(SAMPLE).glb: $(READY) $(wildcard src/bunraku/files/samples/*.glb)
	@$(BIN)/bunraku samples $(SAMPLE) -o demo
	@touch $@

# Chosen files, listed in tests/quick.txt.
quick: $(DEVELOP)
	$(BIN)/python -m pytest -q @tests/quick.txt $(ARGS)

test: $(DEVELOP) .venv/.validator .venv/.browser
	$(BIN)/python -m pytest $(ARGS)

# The Khronos validator checks every GLB that the tests write, and three.js opens some. Both come from npm; without npm those tests are skipped and
# say so, as those with Blender are where there is none.
.venv/.validator: $(DEVELOP) tests/files/validator/package.json tools/check_viewers/package.json
	@if command -v npm >/dev/null; then for folder in tests/files/validator tools/check_viewers; do \
		npm install --silent --no-audit --no-fund --no-package-lock --prefix $$folder || echo "npm install failed in $$folder; its tests are skipped"; \
		done; fi
	@touch $@

browser: $(DEVELOP) .venv/.browser
	$(BIN)/python -m pytest $(addprefix tests/studio/,test_page.py test_page_apparel.py test_page_body.py test_page_live.py) $(ARGS)

# The page is committed as it is built, so a wheel needs no node; `tests/studio` builds it again where there is npm.
studio: studio/node_modules/.package-lock.json
	cd studio && npm run --silent build

studio/node_modules/.package-lock.json: studio/package.json studio/package-lock.json
	@cd studio && npm ci --silent

# The studio's page is tested in Chromium where there is one; without it those tests are skipped and say so.
.venv/.browser: $(DEVELOP) studio/package-lock.json
	@if command -v chromium >/dev/null; then $(BIN)/python -m pip install --quiet --disable-pip-version-check 'playwright>=1.50' \
		|| echo "playwright could not be installed; the tests in a browser are skipped"; fi
	@if command -v npm >/dev/null; then (cd studio && npm ci --silent) || echo "npm ci failed in studio; building its page is not tested"; fi
	@touch $@

# Docstrings are read and not imported, so this needs nothing of the package.
.venv/.docs: .venv/pyvenv.cfg pyproject.toml
	$(PIP) $$($(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")')
	@touch $@

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "documentation: build/docs/index.html"

fuzz: $(DEVELOP)
	$(BIN)/python -W ignore tests/fuzz/fuzz.py --count $(COUNT) --first $(FIRST)

stops: $(DEVELOP)
	$(BIN)/python tests/stops/stops.py kill --count $(TIMES)
	$(BIN)/python tests/stops/stops.py interrupt --count $(TIMES)

soak: $(DEVELOP)
	$(BIN)/python -W ignore tests/soak/soak.py --minutes $(MINUTES)

lint: $(DEVELOP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(DEVELOP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

wheel: $(DEVELOP)
	$(BIN)/python -m hatchling build -t wheel

clean:
	rm -rf demo dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
