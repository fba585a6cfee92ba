#!/bin/sh
# Drives the page in a headless Chromium, against servers on loopback ports.
# Usage: tests/page/run.sh path/to/tessera [--pictures FOLDER]
# With --pictures the screenshots of docs/page.md are written to the folder. The mesh is stanford-bunny.obj of the folder that
# TESSERA_MESHES names, else a generated one. CHROMIUM names the browser, if it is not on the path as `chromium`.
# Installs what package.json names below a temporary folder, and removes it. Needs node 20, npm and a Chromium.
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

work=$(mktemp -d)
open=
locked=
trap 'for pid in $open $locked; do kill "$pid" 2>/dev/null || true; done; rm -rf "$work"' EXIT

# Modules are looked for beside the file that names them.
cp "$here"/*.mjs "$here/package.json" "$work"
(cd "$work" && npm install --silent --no-audit --no-fund --no-package-lock --ignore-scripts >npm.log 2>&1) || {
    cat "$work/npm.log" >&2
    exit 1
}

mesh=${TESSERA_MESHES:+$TESSERA_MESHES/stanford-bunny.obj}
if [ -z "$mesh" ]; then
    mesh=$work/shape.obj
    "$server" shape genus3 --facets 40000 -o "$mesh" >/dev/null
fi

# Waits for a server's line with the address of its HTTP port.
address() {
    tries=0
    until grep -q '^tessera speaks HTTP on ' "$work/$1.out"; do
        tries=$((tries + 1))
        if [ "$tries" -gt 300 ] || ! kill -0 "$2" 2>/dev/null; then
            echo "the server did not start:" >&2
            cat "$work/$1.log" >&2
            exit 1
        fi
        sleep 0.1
    done
    sed -n 's/^tessera speaks HTTP on //p' "$work/$1.out"
}

"$server" serve --ephemeral --listen 127.0.0.1:0 --http-listen 127.0.0.1:0 --ui >"$work/open.out" 2>"$work/open.log" &
open=$!
key=$("$server" keys add page --role submit --data-dir "$work/data")
"$server" serve --data-dir "$work/data" --require-keys --listen 127.0.0.1:0 --http-listen 127.0.0.1:0 --ui \
    >"$work/locked.out" 2>"$work/locked.log" &
locked=$!

PAGE="http://$(address open "$open")/" LOCKED="http://$(address locked "$locked")/" KEY="$key" MESH="$mesh" \
    CHROMIUM="$chromium" PICTURES="$pictures" node "$work/test.mjs" || {
    tail -n 20 "$work/open.log" "$work/locked.log" >&2
    exit 1
}

for pid in $open $locked; do
    kill -TERM "$pid"
    code=0
    wait "$pid" || code=$?
    [ "$code" -eq 0 ] || { echo "a server ended with $code" >&2; exit 1; }
done
open=
locked=
echo "ok"
