#!/bin/sh
# Runs the JavaScript client, and the k6 script in place of k6, against a server on a loopback port.
# Usage: tests/node/run.sh path/to/tessera
# Installs what package.json names below a temporary folder, and removes it. Needs node 20 and npm.
set -eu

server=$(realpath "${1:?usage: run.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=$(mktemp -d)
pid=
trap '[ -z "$pid" ] || kill "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

# Modules are looked for beside the file that names them: so the files go where they are installed.
mkdir -p "$work/tests/node" "$work/deploy/load"
cp "$here"/*.mjs "$here/package.json" "$work/tests/node"
cp "$root/deploy/load/k6.js" "$work/deploy/load/k6.mjs"
cp -R "$root/proto" "$work/proto"
(cd "$work/tests/node" && npm install --silent --no-audit --no-fund --no-package-lock --ignore-scripts >"$work/npm" 2>&1) || {
    cat "$work/npm" >&2
    exit 1
}

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

for test in test.mjs k6.mjs; do
    node "$work/tests/node/$test" "$address" || {
        cat "$work/log" >&2
        exit 1
    }
done

kill -TERM "$pid"
code=0
wait "$pid" || code=$?
pid=
[ "$code" -eq 0 ] || { echo "the server ended with $code" >&2; exit 1; }
echo "ok"
