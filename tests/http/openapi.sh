#!/bin/sh
# Holds a server to its OpenAPI document: schemathesis makes requests of all kinds, and looks whether status, type and body of
# each answer are as the document says, and whether anything fails.
# Usage: tests/http/openapi.sh path/to/tessera
set -eu

server=$(realpath "${1:?usage: openapi.sh path/to/tessera}")
root=$(cd "$(dirname "$0")/../.." && pwd)
venv=$("$root/tests/python/venv.sh")
. "$root/tests/serve.sh"
serve open --ephemeral --http-listen 127.0.0.1:0
address=$(address open "tessera speaks HTTP on")

# What a document cannot say may be refused: a digest that is not that of the body, options that do not go together.
cd "$work"
client "$venv/bin/schemathesis" run "http://$address/v1/openapi.json" --checks all \
    --exclude-checks positive_data_acceptance --suppress-health-check filter_too_much --max-examples 15 --seed 1 --request-timeout 60 --no-color
stop
