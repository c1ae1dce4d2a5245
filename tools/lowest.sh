#!/usr/bin/env bash
# Tests gpusim with the lowest versions of its dependencies (tools/lowest.txt), in an environment of
# its own, .venv-lowest: readers and writers, the sensor, the library and its examples.
#
#   tools/lowest.sh [TESTS...]
#
# PYTHON chooses the interpreter (default: that of .venv).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

environment=.venv-lowest
stamp=$environment/.setup
python=${PYTHON:-.venv/bin/python}
wanted=$({ pwd; "$python" --version; cat pyproject.toml tools/lowest.txt; } | cksum)
if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
    "$python" -m venv --clear "$environment"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check \
        --constraint tools/lowest.txt --editable ".[test]"
    printf '%s\n' "$wanted" >"$stamp"
fi
if [ $# = 0 ]; then
    set -- tests/config tests/formats/test_ready.py tests/scene/test_exr.py \
        tests/scene/test_pictures.py tests/lens/test_glass.py tests/psf/test_store.py \
        tests/sensor/test_noise.py tests/sensor/test_adc.py tests/sensor/test_sensor.py \
        tests/isp/test_dng.py tests/batch/test_axes.py tests/test_camera.py \
        tests/library/test_front.py tests/gpu/test_kernel.py tests/cli/test_names.py
fi
LP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    "$environment/bin/python" -m pytest -n 2 --dist worksteal --durations=3 "$@"
