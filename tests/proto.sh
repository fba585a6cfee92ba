#!/usr/bin/env bash
# Checks the interface in proto/: `buf lint`, and `buf breaking` against what clients may already use.
# Usage: tests/proto.sh
# Compares with the commit that PROTO_AGAINST names. Without it: the last release (a tag v*), else where this branch left main,
# else the commit before. Uses `buf` if it is on the path, or the program that BUF names, else installs it with npm in target/buf.
set -euo pipefail
cd "$(dirname "$0")/.."

version=1.75.0
buf=${BUF:-$(command -v buf || true)}
if [ -z "$buf" ]; then
    buf=target/buf/node_modules/.bin/buf
    if ! [ -x "$buf" ] || [ "$("$buf" --version)" != "$version" ]; then
        command -v npm >/dev/null || { echo "neither buf nor npm is installed" >&2; exit 1; }
        npm install --silent --no-audit --no-fund --prefix target/buf "@bufbuild/buf@$version"
    fi
fi

"$buf" lint
echo "proto/ follows the rules of buf.yaml"

# A commit before this one that this one grew out of, so that what main got meanwhile is not missed here.
against=${PROTO_AGAINST:-}
if [ -z "$against" ]; then
    against=$(git describe --tags --abbrev=0 --match 'v*' 2>/dev/null || true)
fi
for branch in main origin/main; do
    [ -z "$against" ] || break
    found=$(git merge-base HEAD "$branch" 2>/dev/null || true)
    [ "$found" = "$(git rev-parse HEAD)" ] || against=$found
done
if [ -z "$against" ]; then
    against=$(git rev-parse --verify --quiet 'HEAD~1^{commit}' || true)
fi
if [ -z "$against" ]; then
    echo "there is no release, no branch main and no commit before this one: CHANGES ARE NOT CHECKED"
    exit 0
fi

# Out of git's own archive, since buf reads neither worktrees nor shallow clones.
before=$(mktemp -d)
trap 'rm -rf "$before"' EXIT
git archive "$against" proto | tar -x -C "$before"
"$buf" breaking --against "$before/proto"
echo "a client of $(git log -1 --format='%h (%cs)' "$against") can speak with this version"
