#!/bin/sh
# Runs the JavaScript client, and the k6 script in place of k6, against a server on a loopback port.
# Usage: tests/node/run.sh path/to/tessera
# Installs what package.json names below a temporary folder, and removes it. Needs node 20 and npm.
set -eu

server=$(realpath "${1:?usage: run.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
. "$root/tests/serve.sh"

# Modules are looked for beside the file that names them: so the files go where they are installed.
mkdir -p "$work/tests/node" "$work/deploy/load"
cp "$here"/*.mjs "$here/package.json" "$work/tests/node"
cp "$root/deploy/load/k6.js" "$work/deploy/load/k6.mjs"
cp -R "$root/proto" "$work/proto"
(cd "$work/tests/node" && npm install --silent --no-audit --no-fund --no-package-lock --ignore-scripts --prefer-offline >"$work/npm.log" 2>&1) || {
    cat "$work/npm.log" >&2
    exit 1
}

serve open --ephemeral
address=$(address open "tessera listens on")
for test in test.mjs k6.mjs; do
    client node "$work/tests/node/$test" "$address"
done
stop
