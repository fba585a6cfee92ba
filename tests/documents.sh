#!/bin/bash
# Does what README.md and docs/first-steps.md say, as a newcomer would: pastes their blocks word for word into a shell, in a copy of
# this folder.
# Usage: tests/documents.sh [PROGRAM]
# With a program, `cargo install` installs that one instead of compiling it.
# The README's test command and its Rust program are not run here; `cargo test` does that.
set -euo pipefail
cd "$(dirname "$0")/.."

root=$PWD
program=$([ $# -eq 0 ] || realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# A copy as it is now, without what git ignores. Files and folders keep their times, so that cargo knows what it has compiled.
mkdir "$work/tessera"
git ls-files -z --cached --others --exclude-standard | xargs -0 cp --parents --preserve=timestamps -t "$work/tessera"
(cd "$work/tessera" && find . -type d -exec touch --no-create --reference="$root/{}" {} \;)

# What the tests compiled is used again, and what `cargo install` installs goes with the copy: it takes the tests' profile,
# since this looks at words, not at speed.
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
export CARGO_INSTALL_ROOT=$work/installed
mkdir "$work/bin"
cat >"$work/bin/cargo" <<EOF
#!/bin/bash
if [ "\$1" = install ]; then
    if [ -n "$program" ]; then
        exec install -D -m 0755 "$program" "$work/installed/bin/tessera"
    fi
    shift
    exec "$(command -v cargo)" install --debug "\$@"
fi
exec "$(command -v cargo)" "\$@"
EOF
chmod +x "$work/bin/cargo"
export MATURIN_PEP517_ARGS="--profile dev --features tessera/default"
export PATH=$work/bin:$work/installed/bin:$PATH
# Where the README's server keeps its jobs.
export XDG_STATE_HOME=$work/state
for port in 50051 8080; do
    if (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; then
        echo "something listens on port $port, which the README's server uses" >&2
        exit 1
    fi
done
command -v curl >/dev/null || { echo "the README's blocks need curl" >&2; exit 1; }

# All ```sh blocks but the test command's, one after the other in one shell. What needs a container engine is in ```bash.
for page in README.md docs/first-steps.md; do
    awk '
        /<!-- test-command -->/ { skip = 1 }
        /^```sh$/ { inside = !skip; if (inside) print "printf \"\\n-- " FILENAME ", line " FNR "\\n\""; next }
        /^```$/ { if (!inside) skip = 0; inside = 0 }
        inside
    ' "$page" >"$work/blocks"
    (cd "$work/tessera" && timeout 1800 bash -e "$work/blocks")
done
for file in genus3.obj remesh.ply remesh.png report.json remote.ply job.ply by-curl.obj by-python.ply \
    ring.png even.png curved.png block.png near.png; do
    [ -s "$work/tessera/$file" ] || { echo "$file is not there after the blocks" >&2; exit 1; }
done
