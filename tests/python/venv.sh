#!/bin/sh
# Makes the virtual environment of all tests in Python, in target/tests-venv, and prints its folder. It has everything but the
# package `tessera-remesh` itself, which clients/python/tests/run.sh installs. It is made again when a list of packages changes.
# Usage: tests/python/venv.sh
# Needs Python 3.11 with venv.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
venv=$root/target/tests-venv
mkdir -p "$root/target"
# Of two runs at once the second waits, and finds it made.
exec 9>"$venv.lock"
flock 9

lists="clients/python/pyproject.toml tests/python/requirements.txt tests/python/peers.txt deploy/requirements.txt"
cd "$root"
if ! cat $lists | cmp -s - "$venv/made-of"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    # Installs in seconds what takes pip minutes.
    "$venv/bin/pip" install --quiet --disable-pip-version-check "uv>=0.9" >&2
    "$venv/bin/uv" pip install --quiet --python "$venv" --requirements clients/python/pyproject.toml --extra service --extra test \
        --requirements tests/python/requirements.txt --requirements tests/python/peers.txt \
        --requirements deploy/requirements.txt >&2
    cat $lists >"$venv/made-of"
fi
echo "$venv"
