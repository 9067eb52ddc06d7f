# The two commands of the README. Both need uv, which gets a private environment if it is missing.
UV := $(or $(shell command -v uv 2>/dev/null),.uv/bin/uv)
RUN := $(UV) run
DEV := $(RUN) --group dev
BAG := bags/rig_a

# What each of many processes imports is compiled to bytecode once.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo fleet-demo loop test types tests measured docs bags picture

# Fits the linear model to a recording, finds what it lacks, adds that, and compares the two.
demo: $(UV)
	@echo 'The first run sets up .venv (a minute or less) and compiles (about 30 s).' >&2
	$(RUN) hydro-twin trace $(BAG) --plant load_simulator -o out
	$(RUN) hydro-twin replay $(BAG) --model out/model.yaml --beside out/before.yaml \
		--picture out/picture.png
	@echo "See out/report.html and out/picture.png."

# A year of ten simulated valve servos, the play of one of which grows, and the page that shows it.
fleet-demo: $(UV)
	@echo 'The first run sets up .venv; 40 traces take some minutes on two cores.' >&2
	$(RUN) --extra fleet bags/fleet.py out/fleet
	$(RUN) --extra fleet hydro-twin fleet out/fleet/fleet.csv -o out/fleet/out
	@echo "See out/fleet/out/fleet.html."

# A rig that begins to rub and then has play, in real time, and the models that come of it.
loop: $(UV)
	@echo 'Four minutes on two cores that are free, up to eight on others.' >&2
	$(DEV) bags/loop.py out/loop
	@echo "See out/loop/loop.html."

# With CI set, the slow tests too. mypy has one core only to work with, so the tests run beside it.
test: $(UV)
	$(DEV) ruff check
	$(MAKE) --jobs=2 types tests

# What takes minutes: most are traces of measured data in $HYDRO_TWIN_DATA, see docs/measured.md.
measured: $(UV)
	$(DEV) pytest -m measured

types: $(UV)
	$(DEV) mypy

tests: $(UV)
	$(DEV) pytest -n 2 --dist loadfile --no-loadscope-reorder $(if $(CI),-m 'not measured')

# The pages of docs/ and a reference of the docstrings, in out/docs/index.html.
docs: $(UV)
	$(RUN) --group docs python -m sphinx -q -W docs out/docs

# Remake the sample recordings, to the byte.
bags: $(UV)
	$(RUN) bags/make.sh

# Remake the pictures of the README and of docs/live.md.
picture: demo
	cp out/picture.png docs/img/before_after.png
	$(RUN) python -m benchmarks.observer_picture $(BAG) out/model.yaml docs/img/observer.png

.uv/bin/uv:
	python3 -m venv .uv
	.uv/bin/pip install --quiet uv
