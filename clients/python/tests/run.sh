#!/bin/sh
# Installs the package as a user would, with debug code, and runs its tests, those against a server too.
# Usage: clients/python/tests/run.sh path/to/tessera
set -eu
TESSERA=$(realpath "${1:?usage: run.sh path/to/tessera}")
export TESSERA
here=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$here/tools/make_stubs.sh" --check
python3 -m venv "$work/venv"
MATURIN_PEP517_ARGS="--profile dev --locked" \
    "$work/venv/bin/pip" install --quiet --disable-pip-version-check "$here[service,test]"
cd "$here"
"$work/venv/bin/python" -m pytest -q -p no:cacheprovider
