# Every target except help and clean first sets up .venv. This takes half a minute once, and later
# nothing. "make render" installs only what rendering needs.
.DEFAULT_GOAL := help
.PHONY: help setup render notebook docs docs-full test test-fast test-all durations mutants test-kills test-inputs verify lint bench bench-full bench-lost release-check test-versions test-gpu bench-tof clean

OUT ?= out/cornell_box

unexport PYTHONDONTWRITEBYTECODE # else each process of tests compiles all of them anew, in 12 s

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## create .venv, install the package, find or install LLVM
	@sh .ci/setup

render: ## render the Cornell box into $(OUT) (EXR stack, video, figure); ARGS="--spp 16" adds options
	@sh .ci/setup render
	.venv/bin/tofrender render cornell_box --out "$(OUT)" $(ARGS)

notebook: setup ## open the notebooks in JupyterLab; git stores them without outputs
	.venv/bin/jupyter lab --config=.ci/jupyter_config.py $(ARGS)

docs: setup ## build the documentation in build/docs/html, without a network; small notebooks
	.venv/bin/python docs/build.py $(ARGS)

docs-full: setup ## the same with notebooks of full size, for the site that is published
	.venv/bin/python docs/build.py --full $(ARGS)

test: setup ## test every part; ARGS="--changed COMMIT" also runs all tests of changed packages
	.venv/bin/python -m pytest -n auto --dist worksteal --brief $(ARGS)

test-fast: setup ## run the tests that take less than 0.1 s, in about a minute, while you write
	.venv/bin/python -m pytest tests --ignore tests/inputs -n auto --dist worksteal -m "not slow and not statistical" $(ARGS)

test-all: setup ## run all tests, in an hour and a half; SHARD=3/8 runs the third of eight parts
	.venv/bin/python -m pytest -n auto --dist worksteal $(if $(SHARD),--shard $(SHARD)) $(ARGS)

durations: setup ## store what each test takes in make test-all and in make test, by which both choose
	DRJIT_CACHE_DIR=$$(mktemp -d) .venv/bin/python -m pytest -n auto --dist worksteal --store-durations $(ARGS)
	DRJIT_CACHE_DIR=$$(mktemp -d) .venv/bin/python -m pytest -n auto --dist worksteal --brief --store-durations $(ARGS)

mutants: setup ## plant more than 300 bugs, one at a time, and see that the tests find each
	.venv/bin/python -m tests.mutants $(ARGS)

test-kills: setup ## kill and stop commands at sixty random moments, and go on with each, in about five minutes
	TOFRENDER_KILLS=20 .venv/bin/python -m pytest -k random_moment tests/cli/test_cli_stopped.py $(ARGS)

test-inputs: setup ## try every bad input, damaged file and order of labels; make test-all tries a sample
	.venv/bin/python -m pytest -n auto --dist worksteal --all-inputs tests/inputs tests/labels $(ARGS)

verify: setup ## check all assignments with all of their wrong solutions
	for a in a1 a2 a3 a4; do .venv/bin/tofrender verify $$a $(ARGS) || exit 1; done

lint: setup ## check style, types, plain code, and that packages import downwards only
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/pyright
	.venv/bin/lint-imports --no-logo --no-cache
	.venv/bin/python .ci/plain.py

bench: setup ## time the renderer against Mitsuba's steady path tracer and mitransient
	.venv/bin/python -m benchmarks $(ARGS)

bench-full: setup ## error at equal time, scene by scene, in about ten minutes; writes docs/performance.md
	.venv/bin/python -m benchmarks.full $(ARGS)

bench-lost: setup ## cost of checkpoints, films on disk, workers, in about ten minutes; writes docs/checkpoints.md
	.venv/bin/python -m benchmarks.lost $(ARGS)

release-check: setup ## build twice, compare, install on three Pythons, run the README's commands there
	.venv/bin/python .ci/release.py $(ARGS)

test-versions: setup ## run a selection of tests on three Pythons, and with the oldest packages
	.venv/bin/python .ci/versions.py $(ARGS)

test-gpu: setup ## check commands, speed, light and memory on a GPU, in 8 minutes; on a CPU with small sizes
	.venv/bin/python -m benchmarks.gpu $(ARGS)

bench-tof: setup ## test all installed transient renderers; writes out/tofbench and docs/tofbench.md
	.venv/bin/python -m benchmarks.tofbench_page $(ARGS)

clean: ## remove out/, caches and builds (not .venv)
	rm -rf out build dist .pytest_cache .ruff_cache
	find . -path ./.venv -prune -o -name __pycache__ -type d -exec rm -rf {} +
