#!/bin/sh
# Runs the foreign client against a server on a loopback port.
# Usage: tests/python/run.sh path/to/tessera
# Makes a virtual environment and the stubs below a temporary folder, and removes it.
set -eu

server=$(realpath "${1:?usage: run.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=$(mktemp -d)
pid=
trap '[ -z "$pid" ] || kill "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt"
mkdir "$work/stubs"
"$work/venv/bin/python" -m grpc_tools.protoc -I "$root/proto" \
    --python_out="$work/stubs" --grpc_python_out="$work/stubs" "$root"/proto/tessera/v1/*.proto

"$server" serve --data-dir "$work/data" --listen 127.0.0.1:0 >"$work/out" 2>"$work/log" &
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

for test in test_client.py test_jobs.py; do
    PYTHONPATH="$work/stubs:$here" "$work/venv/bin/python" "$here/$test" "$address" "$server" || {
        cat "$work/log" >&2
        exit 1
    }
done

PYTHONPATH="$work/stubs:$here" "$work/venv/bin/python" "$here/test_s3.py" "$server"

kill -TERM "$pid"
code=0
wait "$pid" || code=$?
pid=
[ "$code" -eq 0 ] || { echo "the server ended with $code" >&2; exit 1; }
echo "ok"
