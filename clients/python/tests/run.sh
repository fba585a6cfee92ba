#!/bin/sh
# Installs the package, with debug code, and runs its tests, those against a server too. Then files go from other
# libraries to ours and back (tests/python/formats.py), and gmsh meshes the volume of a remesh, in the same environment.
# Usage: clients/python/tests/run.sh path/to/tessera
set -eu
TESSERA=$(realpath "${1:?usage: run.sh path/to/tessera}")
export TESSERA
here=$(cd "$(dirname "$0")/.." && pwd)
root=$(cd "$here/../.." && pwd)
venv=$("$root/tests/python/venv.sh")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$here/tools/make_stubs.sh" --check
# With what is compiled for the program already, which has more features; the packages it asks for are there.
CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target} MATURIN_PEP517_ARGS="--profile dev --locked --features tessera/default" \
    "$venv/bin/uv" pip install --quiet --python "$venv" --reinstall-package tessera-remesh --no-deps "$here"
"$venv/bin/uv" pip check --quiet --python "$venv"
cd "$here"
"$venv/bin/python" -m pytest -q -p no:cacheprovider

"$venv/bin/python" "$root/tests/python/formats.py" write "$work/formats"
(cd "$root" && TESSERA_FORMATS=$work/formats cargo test --locked --quiet --test mesh -- --ignored files_of_other_libraries)
"$venv/bin/python" "$root/tests/python/formats.py" check "$work/formats"

# The first block of docs/regions.md writes the two chambers.
sed -n '/^```sh$/,/^```$/{/^```$/q;/^```/d;p}' "$root/docs/regions.md" >"$work/chambers.sh"
(cd "$work" && PATH=$(dirname "$TESSERA"):$PATH sh -e chambers.sh >chambers.log 2>&1) || { cat "$work/chambers.log" >&2; exit 1; }
"$venv/bin/python" "$root/tests/python/gmsh_volume.py" "$work/chambers.msh"
