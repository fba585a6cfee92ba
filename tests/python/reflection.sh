#!/bin/sh
# Runs a client without stubs, which learns the interface by reflection, against a server on a loopback port.
# Usage: tests/python/reflection.sh path/to/tessera
# Makes a virtual environment below a temporary folder, and removes it.
set -eu

server=$(realpath "${1:?usage: reflection.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
pid=
trap '[ -z "$pid" ] || kill "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/reflection.txt"

"$server" serve --ephemeral --listen 127.0.0.1:0 >"$work/out" 2>"$work/log" &
pid=$!
tries=0
until grep -q '^tessera listens on ' "$work/out"; do
    tries=$((tries + 1))
    if [ "$tries" -gt 300 ] || ! kill -0 "$pid" 2>/dev/null; then
        echo "the server did not start:" >&2
        cat "$work/log" >&2
        exit 1
    fi
    sleep 0.1
done
address=$(sed -n 's/^tessera listens on //p' "$work/out")

"$work/venv/bin/python" "$here/test_reflection.py" "$address" || {
    cat "$work/log" >&2
    exit 1
}

kill -TERM "$pid"
code=0
wait "$pid" || code=$?
pid=
[ "$code" -eq 0 ] || { echo "the server ended with $code" >&2; exit 1; }
echo "ok"
