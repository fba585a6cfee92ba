#!/bin/sh
# Runs a trial of a cluster: trial.py says what it does, and what it needs.
# Usage: tests/cluster/run.sh path/to/tessera [--short|--long] [CASE...]
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
venv=$("$root/tests/python/venv.sh")
exec "$venv/bin/python" "$root/tests/cluster/trial.py" "$@"
