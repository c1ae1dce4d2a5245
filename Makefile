# Each target first sets up whatever is missing (tools/setup.sh); a second run reinstalls nothing.
# PYTHON=/path/to/python3 chooses the interpreter of .venv.

.PHONY: help demo test lowest docs bench lint format clean
.DEFAULT_GOAL := help

help: ## what can be made
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' Makefile

demo: ## one full capture into out/demo/
	@tools/setup.sh
	@.venv/bin/gpusim render demo demo --exposure 1/12 --certify 64 --memory 512MiB --out out/demo

# Two processes, each with one thread for lavapipe and one for OpenBLAS: most tests keep one core busy
# and more threads than cores only wait for one another. Neither changes a result.
test: ## the whole test suite; ARGS="tests/gpu -x" narrows it, ARGS="-n 0" takes one process
	@tools/setup.sh test
	@LP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
		.venv/bin/python -m pytest -n 2 --dist worksteal $(ARGS)

lowest: ## a part of the tests with the lowest versions of all dependencies
	@tools/setup.sh test
	@tools/lowest.sh

docs: ## build the pages and the API of the library into site/; a broken link or reference fails
	@tools/setup.sh docs
	@.venv/bin/mkdocs build --quiet --strict

bench: ## time a job, warm: NAME=render-demo; without a name, list the jobs
	@tools/setup.sh
	@.venv/bin/python tools/bench.py $(if $(NAME),$(NAME) --json,--list)

lint: ## check style, formatting, and the types of the public library
	@tools/setup.sh test
	@.venv/bin/ruff check
	@.venv/bin/ruff format --check
	@.venv/bin/basedpyright

format: ## format the Python files
	@tools/setup.sh test
	@.venv/bin/ruff format

clean: ## remove what was made, except .venv
	rm -rf out build dist .pytest_cache .hypothesis .ruff_cache site .venv-lowest
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
