#!/bin/bash
# Runs the parts of compose.yaml as processes, where there is no container engine: a server and Prometheus with the same files.
# Usage: deploy/run-local.sh [PROGRAM] [options of `tessera serve`]
# Variables: TESSERA_PORT, TESSERA_ADMIN_PORT and PROMETHEUS_PORT are the ports, SCRAPE_INTERVAL is how often Prometheus looks (15s).
# Needs Debian's package prometheus. Everything listens on this machine alone and ends with Ctrl-C.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
program=${1:-tessera}
[ $# -eq 0 ] || shift

calls=${TESSERA_PORT:-50051} admin=${TESSERA_ADMIN_PORT:-9090} prometheus=${PROMETHEUS_PORT:-9091}
work=$(mktemp -d)
pids=()
stop() {
    trap - EXIT INT TERM
    [ ${#pids[@]} -eq 0 ] || kill -TERM "${pids[@]}" 2>/dev/null || true
    wait || true
    rm -rf "$work"
}
trap stop EXIT
trap 'exit 0' INT TERM

# Prometheus reads its files as they are, but for the address of the server and how often it looks.
sed "s/_interval: 15s/_interval: ${SCRAPE_INTERVAL:-15s}/" "$here/prometheus/prometheus.yml" >"$work/prometheus.yml"
cp "$here/prometheus/alerts.yml" "$work/"
printf -- '- targets: ["127.0.0.1:%s"]\n' "$admin" >"$work/targets.yml"

"$program" serve --listen "127.0.0.1:$calls" --admin-listen "127.0.0.1:$admin" "$@" &
pids+=($!)
prometheus --config.file="$work/prometheus.yml" --storage.tsdb.path="$work/data" \
    --web.listen-address="127.0.0.1:$prometheus" --log.level=warn &
pids+=($!)
echo "calls http://127.0.0.1:$calls, metrics http://127.0.0.1:$admin/metrics, Prometheus http://127.0.0.1:$prometheus"
# Whatever ends first ends the other.
wait -n
