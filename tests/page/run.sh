#!/bin/sh
# Drives the page in a headless Chromium, against servers on loopback ports.
# Usage: tests/page/run.sh path/to/tessera [--pictures FOLDER]
# With --pictures the screenshots of docs/page.md are written to the folder. The mesh is stanford-bunny.obj of the folder that
# TESSERA_MESHES names, else a generated one. CHROMIUM names the browser, if it is not on the path as `chromium`.
# Installs what package.json names below a temporary folder, and removes it. Needs node 20, npm, a Chromium, curl and python3.
set -eu

usage="usage: run.sh path/to/tessera [--pictures FOLDER]"
server=$(realpath "${1:?$usage}")
pictures=
if [ "${2:-}" = --pictures ]; then
    mkdir -p "${3:?$usage}"
    pictures=$(realpath "$3")
fi
here=$(cd "$(dirname "$0")" && pwd)
chromium=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}
[ -n "$chromium" ] || { echo "there is no Chromium on the path; CHROMIUM may name one" >&2; exit 1; }

. "$here/../serve.sh"

# Modules are looked for beside the file that names them.
cp "$here"/*.mjs "$here/package.json" "$work"
(cd "$work" && npm install --silent --no-audit --no-fund --no-package-lock --ignore-scripts --prefer-offline >npm.log 2>&1) || {
    cat "$work/npm.log" >&2
    exit 1
}

mesh=${TESSERA_MESHES:+$TESSERA_MESHES/stanford-bunny.obj}
if [ -z "$mesh" ]; then
    mesh=$work/shape.obj
    "$server" shape torus --facets 40000 -o "$mesh" >/dev/null
fi

serve open --ephemeral --http-listen 127.0.0.1:0 --ui
key=$("$server" keys add page --role submit --data-dir "$work/data")
serve locked --data-dir "$work/data" --require-keys --http-listen 127.0.0.1:0 --ui

page=$(address open "tessera speaks HTTP on")
asks_for_a_key=$(address locked "tessera speaks HTTP on")
client env PAGE="http://$page/" LOCKED="http://$asks_for_a_key/" KEY="$key" MESH="$mesh" CHROMIUM="$chromium" \
    SERVER="$server" CALLS="$here/../../clients/python/python/tessera_remesh/calls.py" PICTURES="$pictures" \
    node "$work/test.mjs"

serve strict --ephemeral --http-listen 127.0.0.1:0 --ui
serve friendly --ephemeral --http-listen 127.0.0.1:0 --cors-origin http://friend.example
strict=$(address strict "tessera speaks HTTP on")
friendly=$(address friendly "tessera speaks HTTP on")
client env PAGE="http://$strict/" FRIENDLY="http://$friendly/" CHROMIUM="$chromium" node "$work/sites.mjs"
stop
