#!/usr/bin/env bash
# Sets up what is missing and nothing else: a virtual environment in .venv with the pinned packages
# and this project, and a Vulkan adapter. A second run finds the stamp of the first and ends at once.
#
#   tools/setup.sh          what `make demo` needs
#   tools/setup.sh test     the same plus the tools of `make test`
#   tools/setup.sh test,judges   the same plus the programs that judge ours, 2 GB
#
# PYTHON chooses the interpreter (default: the first python3 on the PATH that is 3.11 or newer).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

extra=${1:-}
stamp=.venv/.setup${extra:+-$extra}
# Everything that decides what gets installed; the folder too, since a moved .venv no longer works.
wanted=$({ pwd; cat pyproject.toml tools/constraints.txt tools/setup.sh; } | cksum)
if [ -x .venv/bin/python ] && [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ]; then
    exit 0
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: %s\n' "$@" >&2; exit 1; }

# quietly COMMAND...: runs it; its output is shown only where it fails.
quietly() {
    if ! "$@" >"$log" 2>&1; then
        tail -n 30 "$log" >&2
        fail "failed: $*"
    fi
}

# apt PACKAGE...: installs them where there is apt-get, else returns 1.
apt() {
    command -v apt-get >/dev/null || return 1
    local root=()
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null || fail "as root, please run: apt-get install $*"
        root=(sudo)
    fi
    say "installing $* with ${root[*]+sudo }apt-get"
    # A repository that does not answer need not matter: the install says whether it did.
    ${root[@]+"${root[@]}"} apt-get update >"$log" 2>&1 || true
    quietly ${root[@]+"${root[@]}"} env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y --no-install-recommends "$@"
}

recent() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

find_python() {
    local name
    if [ -n "${PYTHON:-}" ]; then
        recent "$PYTHON" || fail "PYTHON=$PYTHON is not a Python 3.11 or newer"
        return
    fi
    for name in python3 python3.14 python3.13 python3.12 python3.11 python; do
        if recent "$name"; then
            PYTHON=$name
            return
        fi
    done
    fail "no Python 3.11 or newer found on the PATH; install one, or name it: make PYTHON=/path/to/python3"
}

make_environment() {
    find_python
    local version
    version=$("$PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    # Debian and Ubuntu ship the venv module without ensurepip, in a package of its own.
    if ! "$PYTHON" -c 'import ensurepip, venv' 2>/dev/null; then
        apt "python$version-venv" || fail "$PYTHON lacks the modules venv and ensurepip; install them"
    fi
    say "making .venv with Python $version"
    quietly "$PYTHON" -m venv --clear .venv
}

# An environment that lost its interpreter, or never got pip, is made anew.
.venv/bin/python -m pip --version >/dev/null 2>&1 || make_environment
say "installing packages into .venv (the first time some 150 MB, one or two minutes)"
quietly .venv/bin/python -m pip install --disable-pip-version-check \
    --constraint tools/constraints.txt --editable ".${extra:+[$extra]}"

has_adapter() { .venv/bin/gpusim devices >"$log" 2>&1; }

if ! has_adapter; then
    say "no Vulkan, Metal or Direct3D 12 adapter found"
    apt libvulkan1 mesa-vulkan-drivers || fail \
        "please install a Vulkan driver, then try again. Without a GPU, Mesa's lavapipe will do:" \
        "  Fedora, RHEL   dnf install vulkan-loader mesa-vulkan-drivers" \
        "  Arch           pacman -S vulkan-icd-loader vulkan-swrast" \
        "  openSUSE       zypper install libvulkan1 libvulkan_lvp" \
        "  macOS          nothing: Metal is part of the system, so this Mac is not supported"
    has_adapter || { cat "$log" >&2; fail "still no adapter; this is what 'gpusim devices' says"; }
fi
say "ready"
printf '%s\n' "$wanted" >"$stamp"
