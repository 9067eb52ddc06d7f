# The two commands of the README. Both need uv, which gets a private environment if it is missing.
UV := $(or $(shell command -v uv 2>/dev/null),.uv/bin/uv)
RUN := $(UV) run
DEV := $(RUN) --group dev
BAG := bags/load_simulator_linear

.PHONY: demo test bags

demo: $(UV)
	mkdir -p out
	$(RUN) hydro-twin refit $(BAG) --plant load_simulator -o out/model.yaml
	$(RUN) hydro-twin replay $(BAG) --model out/model.yaml

# With CI set, the slow tests too.
test: $(UV)
	$(DEV) ruff check
	$(DEV) mypy
	$(DEV) pytest $(if $(CI),-m 'slow or not slow')

# Remake the sample recordings, to the byte.
bags: $(UV)
	$(RUN) bags/make.sh

.uv/bin/uv:
	python3 -m venv .uv
	.uv/bin/pip install --quiet uv
