#!/bin/bash
# Goes from a release archive to a first result as a newcomer does: checksums, unpack, a surface, its remesh and its picture.
# Usage: deploy/check_archive.sh FOLDER
# FOLDER is what deploy/release.sh wrote. It prints the seconds and fails beyond a minute. No compiler is used.
set -euo pipefail

archives=$(realpath "${1:?usage: check_archive.sh FOLDER}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
begin=$(date +%s%N)
(cd "$archives" && sha256sum --check --quiet SHA256SUMS)
tar -xzf "$archives"/tessera-*.tar.gz --strip-components 1
# Nothing else of this machine: what the program calls would be missing.
export PATH=$work/bin:/usr/bin:/bin
tessera shape genus3 --facets 20000 -o genus3.obj
tessera remesh genus3.obj --points 4000 -o remesh.ply --picture remesh.png
taken=$((($(date +%s%N) - begin) / 1000000))

for file in remesh.ply remesh.png share/doc/tessera/THIRD-PARTY.txt share/doc/tessera/tessera.cdx.json share/man/man1/tessera.1.gz; do
    [ -s "$file" ] || { echo "$file is missing" >&2; exit 1; }
done
echo "from the archive to the first result: $((taken / 1000)).$(printf %03d $((taken % 1000))) s"
[ "$taken" -le 60000 ] || { echo "that is more than a minute" >&2; exit 1; }
