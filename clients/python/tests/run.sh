#!/bin/sh
# Installs the package as a user would, with debug code, and runs its tests, those against a server too. Then files go from other
# libraries to ours and back (tests/python/formats.py), in the same environment.
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

root=$here/../..
"$work/venv/bin/python" "$root/tests/python/formats.py" write "$work/formats"
(cd "$root" && TESSERA_FORMATS=$work/formats cargo test --locked --quiet --test mesh -- --ignored files_of_other_libraries)
"$work/venv/bin/python" "$root/tests/python/formats.py" check "$work/formats"
