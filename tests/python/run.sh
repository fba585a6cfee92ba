#!/bin/sh
# Runs the foreign client against a server on a loopback port.
# Usage: tests/python/run.sh path/to/tessera
set -eu

server=$(realpath "${1:?usage: run.sh path/to/tessera}")
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
venv=$("$here/venv.sh")
. "$root/tests/serve.sh"

mkdir "$work/stubs"
"$venv/bin/python" -m grpc_tools.protoc -I "$root/proto" \
    --python_out="$work/stubs" --grpc_python_out="$work/stubs" "$root"/proto/tessera/v1/*.proto
export PYTHONPATH="$work/stubs:$here"

serve kept --data-dir "$work/data"
address=$(address kept "tessera listens on")
for test in test_client.py test_jobs.py; do
    client "$venv/bin/python" "$here/$test" "$address" "$server"
done
"$venv/bin/python" "$here/test_s3.py" "$server"
stop
