#!/bin/sh
# Runs a client without stubs, which learns the interface by reflection, against a server on a loopback port.
# Usage: tests/python/reflection.sh path/to/tessera
set -eu

server=$(realpath "${1:?usage: reflection.sh path/to/tessera}")
root=$(cd "$(dirname "$0")/../.." && pwd)
venv=$("$root/tests/python/venv.sh")
. "$root/tests/serve.sh"
serve open --ephemeral
address=$(address open "tessera listens on")
client "$venv/bin/python" "$root/tests/python/test_reflection.py" "$address"
stop
