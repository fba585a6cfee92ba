#!/bin/sh
# Makes python/tessera_remesh/service/_stubs from the interface in proto/.
# The generator is that of the oldest protobuf that the package allows: newer ones read its code, older ones do not.
# Usage: clients/python/tools/make_stubs.sh [--check]
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
proto=$(cd "$here/../../proto" && pwd)
stubs=$here/python/tessera_remesh/service/_stubs
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check "grpcio-tools==1.75.1" "protobuf==6.31.1"
mkdir "$work/made"
for name in blob job remesh; do
    "$work/venv/bin/python" -m grpc_tools.protoc -I "$proto" --python_out="$work/made" --pyi_out="$work/made" \
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
