#!/bin/sh
# Lays out what a release consists of: the program, its documents, its licences and its bill of materials.
# Usage: deploy/release/stage.sh PROGRAM FOLDER
# FOLDER gets bin/, share/doc/tessera/, share/man/man1/ and the shells' completions, as below /usr/local.
set -eu

program=${1:?usage: stage.sh PROGRAM FOLDER}
out=${2:?usage: stage.sh PROGRAM FOLDER}
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
target=${TARGET:-$(rustc -vV | sed -n 's/^host: //p')}
name=tessera
case $target in *windows*) name=tessera.exe ;; esac

doc=$out/share/doc/tessera
mkdir -p "$out/bin" "$doc"
install -m 0755 "$program" "$out/bin/$name"
install -m 0644 "$root/LICENSE" "$root/README.md" "$doc/"
python3 "$here/notices.py" licences --target "$target" >"$doc/THIRD-PARTY.txt"
python3 "$here/notices.py" sbom --target "$target" >"$doc/tessera.cdx.json"

complete() {
    mkdir -p "$out/share/$(dirname "$2")"
    "$out/bin/$name" completions "$1" >"$out/share/$2"
}
complete bash bash-completion/completions/tessera
complete zsh zsh/site-functions/_tessera
complete fish fish/vendor_completions.d/tessera.fish
mkdir -p "$out/share/man/man1"
"$out/bin/$name" man --out-dir "$out/share/man/man1"
find "$out/share/man/man1" -name '*.1' -exec gzip --best --no-name {} +
