#!/bin/sh
# Checks the page: its types, and whether dist/ is what the sources give.
# Usage: ui/check.sh
# Installs what package-lock.json names below a temporary folder, and removes it. Needs node 20 and npm.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

mkdir "$work/ui"
(cd "$here" && cp -R src build.mjs tsconfig.json package.json package-lock.json .npmrc "$work/ui")
npm ci --silent --prefix "$work/ui" >"$work/npm.log" 2>&1 || {
    cat "$work/npm.log" >&2
    exit 1
}
npm run --silent --prefix "$work/ui" check
(cd "$work/ui" && node build.mjs "$work/dist")
if ! diff -r "$work/dist" "$here/dist" >/dev/null; then
    diff -rq "$work/dist" "$here/dist" >&2 || true
    echo "ui/dist is not what ui/src gives: npm ci --prefix ui && npm run --prefix ui build" >&2
    exit 1
fi
echo "ui/dist is what ui/src gives"
