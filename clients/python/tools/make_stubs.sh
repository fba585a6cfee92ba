#!/bin/sh
# Makes python/tessera_remesh/service/_stubs from the interface in proto/.
# The generator is that of the oldest protobuf that the package allows (tests/python/requirements.txt): newer ones read its code, older
# ones do not.
# Usage: clients/python/tools/make_stubs.sh [--check]
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
proto=$(cd "$here/../../proto" && pwd)
stubs=$here/python/tessera_remesh/service/_stubs
venv=$("$here/../../tests/python/venv.sh")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/made"
for name in blob job remesh; do
    "$venv/bin/python" -m grpc_tools.protoc -I "$proto" --python_out="$work/made" --pyi_out="$work/made" \
        "$proto/tessera/v1/$name.proto"
done
for name in blob job remesh; do
    for end in py pyi; do
        sed -i 's/^from tessera\.v1 import/from . import/' "$work/made/tessera/v1/${name}_pb2.$end"
    done
done
printf '"""Messages of the service, made from proto/ by tools/make_stubs.sh."""\n' >"$work/made/tessera/v1/__init__.py"
if [ "${1-}" = --check ]; then
    diff -r -x __pycache__ "$work/made/tessera/v1" "$stubs" || { echo "the stubs are old: run tools/make_stubs.sh" >&2; exit 1; }
else
    rm -rf "$stubs"
    cp -r "$work/made/tessera/v1" "$stubs"
fi
