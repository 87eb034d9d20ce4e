# make demo   the main job on a bare clone: makes .venv, installs, runs diagrams/scenarios/paper_fig7.yaml
# make test   the same set-up, then the tests but the long ones: some four minutes on two cores
# make check  the fast part of them, a quarter of the random examples, for daily work: less than a minute
PYTHON ?= python3
VENV := .venv
# dev, or test: the same without torch, whose tests are then skipped.
EXTRA := dev
PINS := -c constraints.txt
BIN := $(VENV)/bin
BASE := $(VENV)/.base
STAMP := $(VENV)/.installed-$(EXTRA)
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check $(PINS)
# A worker a core: more threads in each would only wait for one another.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.PHONY: demo install test compiled test-all check newest golden processors results lint bench docs docs-quick picture gallery robots calibration calibration-example identification integrators margins plan reproduction montecarlo random_faults random_beliefs reachy drive fair fair_verdict tuner_baselines tuner_verdict tuner_front tuner_policy tuner_training tuner_safety three tab format clean servo_identification adaptation

demo: $(BASE)
	$(BIN)/stewart-drake run diagrams/scenarios/paper_fig7.yaml --plots --out runs/paper_fig7

install: $(STAMP)

# What users need; `install` adds what tests and documentation need.
$(BASE): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed; set PYTHON=...")'
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) -e .
	touch $@

# Reachy Mini's model for MuJoCo and its dances are in its maker's packages, which would bring all that drives the real one.
MODEL := $(shell sed -n 's|^mjcf: package:\([^/]*\)/.*|\1|p' stewart_drake/robots/reachy_mini.yaml)
DANCES := $(shell sed -n 's|^DANCES = "\(.*\)"|\1|p' stewart_drake/references/moves.py)
$(STAMP): $(BASE)
	$(PIP) -e '.[$(EXTRA)]'
	$(PIP) --no-deps '$(MODEL)' '$(DANCES)'
	touch $@

PYTEST := $(ONE_THREAD) $(BIN)/pytest -n auto --dist loadgroup --ignore=tests/benchmarks

# Once for all workers, which would compile the same laws side by side.
compiled: install
	$(ONE_THREAD) $(BIN)/python tests/compile_laws.py

# All but those marked long.
test: compiled
	$(PYTEST) -m "not long"

# The long ones too: notebooks, pages in a browser, the site, the wheel, all numbers of docs/results. Half an hour.
# Debian: chromium, clang. REACHY_DAEMON=FOLDER installs the daemon of Reachy Mini's maker there and tries it.
test-all: compiled
	$(PYTEST)

# All but those marked slow or long: no study, no long run, no other process.
check: compiled
	$(PYTEST) -q -m "not slow and not long" --hypothesis-profile=check --ignore=tests/paper

# The fast tests with the newest release of each package, whatever constraints.txt says, in an environment of its own.
NEWEST := VENV=.venv-newest EXTRA=test PINS=
newest:
	rm -rf .venv-newest
	$(MAKE) install $(NEWEST)
	.venv-newest/bin/stewart-drake doctor
	$(MAKE) check $(NEWEST)

# Some numbers of each page of docs/results, computed anew and compared with the page: a minute or two.
results: install
	$(PYTEST) -q tests/test_results_pages.py

# The contract: whether everything computes what is recorded in tests/golden; some minutes. See tests/golden_set.py.
golden: install
	$(BIN)/python tests/golden_set.py check

# The same with the arithmetic of other processors, and the tests that state numbers: half an hour for all settings.
processors: install
	$(BIN)/python tests/processors.py

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The part of three.js that the pages use, bundled anew; needs npm.
three:
	npm install --silent --no-save --prefix build/three three@0.187.0 esbuild@0.28.2
	NODE_PATH=build/three/node_modules build/three/node_modules/.bin/esbuild stewart_drake/pages/three.entry.js --bundle --minify \
		--format=iife --global-name=THREE --banner:js='/*! three.js 0.187.0, https://threejs.org, MIT */' --legal-comments=inline \
		--outfile=stewart_drake/pages/three.min.js

bench: install
	$(BIN)/pytest tests/benchmarks -p no:xdist -s -q --benchmark-quiet

# The documentation site, docs/_build/html/index.html, with the notebooks executed: some five minutes.
SPHINX := $(ONE_THREAD) $(BIN)/python -m sphinx -E -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html
# Debian: clang, lld. The site has the robot in a tab where this was made before.
tab: install
	$(BIN)/python docs/tab.py

docs: install
	$(SPHINX) -D nb_execution_mode=force

# The same with the notebooks as they are: a minute.
docs-quick: install
	$(SPHINX)

# The README's picture of the robot, and those of docs/how_it_works.md and docs/in_drake.md (Debian: chromium).
picture: install
	$(BIN)/python docs/draw_robot.py
	$(BIN)/python docs/draw_density.py
	$(BIN)/python docs/draw_meshcat.py

# The films of docs/gallery.md, and the README's: two minutes.
gallery: install
	$(BIN)/python docs/draw_gallery.py

# docs/results/calibration.md, and the example of docs/calibration.md.
calibration: install
	$(BIN)/python docs/calibration_study.py

calibration-example: install
	$(BIN)/python docs/calibration_example.py

# docs/results/margins.md and its picture, five minutes on one core.
margins: install
	$(BIN)/python docs/margins_study.py

# Three policies, from three seeds, an hour each on two cores; each goes on where it stopped.
POLICIES := $(foreach seed,1 2 3,runs/tuner-policy/seed-$(seed).json)
tuner_policy: $(POLICIES)

runs/tuner-policy/seed-%.json: | install
	$(ONE_THREAD) $(BIN)/stewart-drake train --tuner policy --seed $* --out $@

# The shipped policy and these on further situations, for docs/results/tuner_training.md: a quarter of an hour.
tuner_training: tuner_policy
	$(BIN)/python docs/tuner_training.py stewart_drake/weights/policy.json $(POLICIES)

# docs/results/tuner_safety.md and its picture: the box of the shipped policy, half an hour on one core.
tuner_safety: install
	$(ONE_THREAD) $(BIN)/python docs/tuner_safety_study.py

# docs/results/integrators.md and its picture: five minutes on one core.
integrators: install
	$(ONE_THREAD) $(BIN)/python docs/integrators.py

# docs/results/drive.md and its picture: ten minutes, after half a minute that installs the daemon.
drive: install
	$(BIN)/python docs/drive_reachy.py

# docs/results/reachy.md and its picture: two minutes.
reachy: install
	$(ONE_THREAD) $(BIN)/python docs/write_reachy.py

# docs/results/identification.md: half an hour.
identification: install
	$(BIN)/python docs/identification_study.py

# docs/results/servo_identification.md: a quarter of an hour on two cores.
servo_identification: install
	$(ONE_THREAD) $(BIN)/python docs/servo_identification_study.py

# docs/results/adaptation.md: half an hour on two cores.
adaptation: install
	$(ONE_THREAD) $(BIN)/python docs/adaptation_study.py

# The robots that are shipped, and that of docs/your_robot.md.
robots: install
	for name in paper reachy_mini servo_hexapod; do \
	  $(BIN)/stewart-drake robots show $$name --quiet --picture docs/images/robots/$$name.png; done
	$(BIN)/stewart-drake robots from-table docs/your_robot.csv --unit mm --cranks towards --set crank_length=30 \
	  --set rod_length=180 --out docs/your_robot.yaml
	$(BIN)/stewart-drake robots show docs/your_robot.yaml --picture docs/images/robots/your_robot.png
	rm docs/your_robot.yaml

# The README's plan of the rooms.
plan: install
	$(BIN)/python docs/draw_plan.py

# The paper's claims at both sizes: the committed table of numbers, and docs/results/reproduction.md.
reproduction: install
	$(BIN)/python docs/write_reproduction.py

# Four thousand runs, half an hour on two cores, and docs/results/monte_carlo.md.
montecarlo: install
	$(BIN)/stewart-drake sweep monte_carlo --out runs/monte_carlo
	$(BIN)/python docs/write_monte_carlo.py runs/monte_carlo

# docs/results/random_beliefs.md: five thousand situations, an hour and a half on two cores.
random_beliefs: install
	$(ONE_THREAD) $(BIN)/python docs/random_beliefs.py

# docs/results/random_faults.md: 500 faults, five minutes on one core.
random_faults: install
	$(BIN)/python docs/random_faults.py

# Four controllers searched and judged alike, an hour on one core; docs/results/fair_comparison.md, and the settings found.
fair: install
	$(BIN)/stewart-drake tune fair --out runs/fair-tune
	$(BIN)/python docs/write_fair.py runs/fair-tune

# The same page from the settings that are kept, judged on the code as it is: three minutes.
fair_verdict: install
	$(BIN)/python docs/write_fair.py

# What a trained tuner has to beat, in stewart_drake/weights/baselines.yaml: half an hour on one core.
tuner_baselines: install
	$(BIN)/python docs/tuner_baselines.py runs/tuner-baselines

# Tuners and settings that stay, on both engines, twenty minutes on two cores; docs/results/tuner.md.
tuner_verdict: install
	$(BIN)/stewart-drake tuner judge --plant closed_form --seeds 10 --out runs/tuner-fast
	$(BIN)/stewart-drake tuner judge --seeds 10 --only stiff --only "best of each robot" --out runs/tuner-drake
	$(BIN)/python docs/write_tuner.py runs/tuner-fast runs/tuner-drake

# Error against change of torque, docs/results/tuner_front.md: ten minutes.
tuner_front: install
	$(BIN)/python docs/tuner_front.py runs/tuner-front

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) .venv-newest .venv-ci runs dist build docs/_build docs/notebooks docs/reference .mypy_cache .ruff_cache .pytest_cache
