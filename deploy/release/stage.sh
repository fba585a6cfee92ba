#!/bin/sh
# Lays out what a release consists of: the program, its documents, its licences and its bill of materials.
# Usage: deploy/release/stage.sh PROGRAM FOLDER
# FOLDER gets bin/, share/doc/tessera/, share/man/man1/ and share/ of the shells, as below /usr.
set -eu

program=${1:?usage: stage.sh PROGRAM FOLDER}
out=${2:?usage: stage.sh PROGRAM FOLDER}
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
target=${TARGET:-x86_64-unknown-linux-gnu}

doc=$out/share/doc/tessera
mkdir -p "$out/bin" "$doc"
install -m 0755 "$program" "$out/bin/tessera"
install -m 0644 "$root/LICENSE" "$root/README.md" "$doc/"
python3 "$here/notices.py" licences --target "$target" >"$doc/THIRD-PARTY.txt"
python3 "$here/notices.py" sbom --target "$target" >"$doc/tessera.cdx.json"

# Writes what `tessera ARGUMENTS` prints, unless this version has no such command.
print_to() {
    file=$1
    shift
    mkdir -p "$(dirname "$file")"
    if ! "$out/bin/tessera" "$@" >"$file" 2>/dev/null; then
        rm -f "$file"
        rmdir -p --ignore-fail-on-non-empty "$(dirname "$file")"
    fi
}
print_to "$out/share/bash-completion/completions/tessera" completions bash
print_to "$out/share/zsh/vendor-completions/_tessera" completions zsh
print_to "$out/share/fish/vendor_completions.d/tessera.fish" completions fish
print_to "$out/share/man/man1/tessera.1" man
