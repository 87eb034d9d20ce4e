# `make help` lists the targets. Python packages go to .venv, which `install` makes; versions are those of constraints.txt.
PYTHON ?= python3
VENV := .venv
# dev, or test: the same without torch, whose tests are then skipped.
EXTRA := dev
PINS := -c constraints.txt
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PINS)
# Tests and studies use a process for each core, with one thread.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PYTEST := $(ONE_THREAD) $(BIN)/pytest -n auto --dist loadgroup --ignore=tests/benchmarks
SPHINX := $(ONE_THREAD) $(BIN)/python -m sphinx -E -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html
CLI := $(ONE_THREAD) $(BIN)/stewart-drake
SCRIPT := $(ONE_THREAD) $(BIN)/python docs/scripts

.PHONY: help demo install compiled check test test-all newest results golden processors lint format bench docs docs-quick tab pictures three clean

help: ## this list
	@sed -n 's/^\([a-z/%-]*\):.* ## /\1 @/p' $(MAKEFILE_LIST) | sed 's/%/NAME/' | awk -F@ '{printf "make %-13s %s\n", $$1, $$2}'
	@echo 'NAME: $(sort $(patsubst page_%,%,$(filter page_%,$(.VARIABLES))))'

demo: $(VENV)/.base ## install what users need, and run the paper's motion in simulation
	$(BIN)/stewart-drake run diagrams/scenarios/paper_fig7.yaml --plots --out runs/paper_fig7

install: $(VENV)/.installed-$(EXTRA) ## install what tests and documentation need

$(VENV)/.base: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed; set PYTHON=...")'
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) -e .
	touch $@

# Reachy Mini's model for MuJoCo and its dances: two packages of its maker, without the packages that drive a real one.
MODEL := $(shell sed -n 's|^mjcf: package:\([^/]*\)/.*|\1|p' stewart_drake/robots/reachy_mini.yaml)
DANCES := $(shell sed -n 's|^DANCES = "\(.*\)"|\1|p' stewart_drake/reachy/moves.py)
$(VENV)/.installed-$(EXTRA): $(VENV)/.base
	$(PIP) -e '.[$(EXTRA)]'
	$(PIP) --no-deps '$(MODEL)' '$(DANCES)'
	touch $@

compiled: install ## compile the laws once, before several processes need them
	$(ONE_THREAD) $(BIN)/python tests/compile_laws.py

check: compiled ## the fast tests, for daily work: less than a minute
	$(PYTEST) -q -m "not slow and not long" --hypothesis-profile=check --ignore=tests/paper

test: compiled ## all tests but the long ones: four minutes on two cores
	$(PYTEST) -m "not long"

# Needs Debian's chromium. REACHY_DAEMON=FOLDER installs the daemon of Reachy Mini's maker there, and tests it.
test-all: compiled ## all tests: notebooks, pages in a browser, the site, the wheel too; half an hour
	$(PYTEST)

NEWEST := VENV=.venv-newest EXTRA=test PINS=
newest: ## the fast tests with the newest release of each package, in .venv-newest
	rm -rf .venv-newest
	$(MAKE) install $(NEWEST)
	.venv-newest/bin/stewart-drake doctor
	$(MAKE) check $(NEWEST)

results: install ## recompute some numbers of each page of docs/results, and compare: two minutes
	$(PYTEST) -q tests/test_results_pages.py

# How to remake docs/results/NAME.md: `make results/NAME`. Times are for two cores.
# Half an hour.
page_adaptation = $(SCRIPT)/adaptation_study.py
page_calibration = $(SCRIPT)/calibration_study.py
# Ten minutes; the daemon of Reachy Mini's maker is installed first.
page_drive = $(SCRIPT)/drive_reachy.py
define page_faults
$(CLI) faults --out runs/faults
$(CLI) faults --out runs/faults-observer --set estimator.kind=observer
$(CLI) faults --out runs/faults-sensor --set estimator.kind=observer --set sensors.kind=encoders --set sensors.imu.preset=bmi088 --set command_delay=1
$(SCRIPT)/write_faults.py runs/faults runs/faults-observer runs/faults-sensor
endef
# Three minutes, from the settings that are kept. With the folder of `tune fair` as argument the script keeps new ones.
page_fair_comparison = $(SCRIPT)/write_fair.py
# Half an hour.
page_identification = $(SCRIPT)/identification_study.py
# Five minutes.
page_integrators = $(SCRIPT)/integrators.py
# Five minutes.
page_margins = $(SCRIPT)/margins_study.py
# Half an hour: four thousand runs.
page_monte_carlo = $(CLI) sweep monte_carlo --out runs/monte_carlo && $(SCRIPT)/write_monte_carlo.py runs/monte_carlo
# A quarter of an hour.
page_random_faults = $(SCRIPT)/random_faults.py
# Five minutes.
page_imu = $(SCRIPT)/imu_study.py
# Two minutes.
page_ball = $(SCRIPT)/ball_study.py
# Two minutes.
page_lost_encoder = $(SCRIPT)/lost_encoder.py
# Five minutes. Without the number five times as many healthy seconds, a million.
page_parity = $(SCRIPT)/parity_study.py 0.2
# Two minutes.
page_reach = $(SCRIPT)/reach_study.py
# Two minutes.
page_reachy = $(SCRIPT)/write_reachy.py
# An hour; writes stewart_drake/paper/claims.csv too.
page_reproduction = $(SCRIPT)/write_reproduction.py
page_robots = $(SCRIPT)/write_robots.py
# A quarter of an hour.
page_servo_identification = $(SCRIPT)/servo_identification_study.py
# Twenty minutes.
define page_tuner
$(CLI) tuner judge --plant closed_form --seeds 10 --out runs/tuner-fast
$(CLI) tuner judge --seeds 10 --only stiff --only "best of each robot" --out runs/tuner-drake
$(SCRIPT)/write_tuner.py runs/tuner-fast runs/tuner-drake
endef

results/%: install ## remake docs/results/NAME.md; how long it takes is in the Makefile
	$(or $(page_$*),$(error no command for docs/results/$*.md in the Makefile))

golden: install ## compare computed numbers with those recorded in tests/golden: some minutes
	$(BIN)/python tests/golden_set.py check

processors: install ## the same, and tests that state numbers, with the rounding of other processors: half an hour
	$(BIN)/python tests/processors.py

lint: install ## ruff, mypy, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install ## format the code
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: install ## measure what the loop costs, for docs/using.md
	$(BIN)/pytest tests/benchmarks -p no:xdist -s -q --benchmark-quiet

docs: tab ## the site, docs/_build/html/index.html, with the notebooks executed: five minutes
	$(SPHINX) -D nb_execution_mode=force

docs-quick: tab ## the site with the notebooks as they are: a minute
	$(SPHINX)

tab: install ## docs/tab.html, the robot in a browser's tab
	$(BIN)/python docs/scripts/tab.py

# The picture of docs/your_robot.md is the `desk.png` that its commands write.
pictures: install ## pictures and films of the documentation; needs Debian's chromium
	for name in plan robot density ball meshcat gallery; do $(BIN)/python docs/scripts/draw_$$name.py || exit 1; done
	for name in paper reachy_mini servo_hexapod; do \
	  $(BIN)/stewart-drake robots show $$name --quiet --picture docs/images/robots/$$name.png || exit 1; done

three: ## bundle the part of three.js that the pages use; needs npm
	npm install --silent --no-save --prefix build/three three@0.187.0 esbuild@0.28.2
	NODE_PATH=build/three/node_modules build/three/node_modules/.bin/esbuild stewart_drake/pages/three.entry.js --bundle --minify \
		--format=iife --global-name=THREE --banner:js='/*! three.js 0.187.0, https://threejs.org, MIT */' --legal-comments=inline \
		--outfile=stewart_drake/pages/three.min.js

clean: ## remove environments, results and what was built
	rm -rf $(VENV) .venv-newest .venv-ci runs dist build docs/_build docs/notebooks docs/reference .mypy_cache .ruff_cache .pytest_cache
