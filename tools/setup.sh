#!/usr/bin/env bash
# Makes .venv, installs fdem with its extras, and sees to the system libraries that gmsh and VTK load.
set -euo pipefail
cd "$(dirname "$0")/.."

# the names are the same on Debian 12 and Ubuntu 24.04; the first six for gmsh, the last two for pictures
LIBRARIES="libglu1-mesa libgl1 libxcursor1 libxft2 libxinerama1 libgomp1 libegl1 libgl1-mesa-dri"

install_packages() {
    local wanted="$1"
    if ! command -v apt-get >/dev/null; then
        echo "Missing system packages; on Debian they are called: $wanted" >&2
        return 1
    fi
    if [ "$(id -u)" != 0 ]; then
        echo "System packages are missing. Run this, then make again:" >&2
        echo "    sudo apt-get update && sudo apt-get install -y --no-install-recommends $wanted" >&2
        return 1
    fi
    apt-get update -qq
    # shellcheck disable=SC2086 -- the list is meant to be split
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $wanted
}

if [ ! -x .venv/bin/python ]; then
    if ! "$PYTHON" -c "import ensurepip" 2>/dev/null; then
        install_packages python3-venv
    fi
    "$PYTHON" -m venv .venv
fi
.venv/bin/python -c "import sys; sys.exit('fdem needs Python 3.11 or newer' if sys.version_info < (3, 11) else 0)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[plot,dev]"

if ! .venv/bin/python tools/check_system.py; then
    install_packages "$LIBRARIES"
    .venv/bin/python tools/check_system.py
fi
