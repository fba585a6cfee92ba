#!/bin/sh
# Holds a server to its OpenAPI document: schemathesis makes requests of all kinds, and looks whether status, type and body of
# each answer are as the document says, and whether anything fails.
# Usage: tests/http/openapi.sh path/to/tessera
set -eu

server=$(realpath "${1:?usage: openapi.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
pid=
trap '[ -z "$pid" ] || kill "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt"

"$server" serve --ephemeral --listen 127.0.0.1:0 --http-listen 127.0.0.1:0 >"$work/out" 2>"$work/log" &
pid=$!
tries=0
until grep -q '^tessera speaks HTTP on ' "$work/out"; do
    tries=$((tries + 1))
    if [ "$tries" -gt 300 ] || ! kill -0 "$pid" 2>/dev/null; then
        echo "the server did not start:" >&2
        cat "$work/log" >&2
        exit 1
    fi
    sleep 0.1
done
address=$(sed -n 's/^tessera speaks HTTP on //p' "$work/out")

# What a document cannot say may be refused: a digest that is not that of the body, options that do not go together.
cd "$work"
"$work/venv/bin/schemathesis" run "http://$address/v1/openapi.json" --checks all \
    --exclude-checks positive_data_acceptance --suppress-health-check filter_too_much --max-examples 15 --seed 1 --request-timeout 60 --no-color || {
    cat "$work/log" >&2
    exit 1
}

kill -TERM "$pid"
code=0
wait "$pid" || code=$?
pid=
[ "$code" -eq 0 ] || { echo "the server ended with $code" >&2; exit 1; }
echo "ok"
