#!/bin/bash
# Builds a release archive: program, README, licences, bill of materials, man page and completions, and SHA256SUMS.
# Usage: deploy/release.sh [--program PATH] [--out FOLDER]
#   --program PATH   packs this program instead of building one
#   --out FOLDER     where the archive goes; target/release-archive if not given
# The same sources, toolchain and machine type give the same bytes.
set -euo pipefail
cd "$(dirname "$0")/.."

program=
out=target/release-archive
while [ $# -gt 0 ]; do
    case $1 in
        --program) program=${2:?--program needs a path}; shift 2 ;;
        --out) out=${2:?--out needs a folder}; shift 2 ;;
        *) sed -n '2,6s/^# //p' "$0" >&2; exit 2 ;;
    esac
done

version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -n 1)
host=$(rustc -vV | sed -n 's/^host: //p')
name=tessera-$version-$host
case $host in *windows*) suffix=.exe ;; *) suffix= ;; esac
# Times in the archive are the commit's.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH TARGET=$host

if [ -z "$program" ]; then
    TESSERA_REVISION=${TESSERA_REVISION:-$(git rev-parse HEAD)$(git diff --quiet HEAD || echo -modified)}
    export TESSERA_REVISION
    # No path of this machine stays in the program.
    export RUSTFLAGS="${RUSTFLAGS:-} --remap-path-prefix=$PWD=/tessera --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=/cargo"
    cargo build --locked --profile dist --bin tessera
    program=${CARGO_TARGET_DIR:-target}/dist/tessera$suffix
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
deploy/release/stage.sh "$program" "$work/$name"
mkdir -p "$out"
install -m 0644 "$work/$name/share/doc/tessera/tessera.cdx.json" "$out/$name.cdx.json"
python3 deploy/release/pack.py "$work/$name" "$out" "$name.cdx.json"

glibc=$(LC_ALL=C grep -aoE 'GLIBC_[0-9]+\.[0-9]+' "$program" | sort -uV | tail -n 1) || true
echo "needs ${glibc:-no C library of GNU}"
