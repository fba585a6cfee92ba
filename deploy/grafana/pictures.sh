#!/bin/bash
# Puts a server under load for five minutes, and makes the pictures of its dashboard that docs/observability.md shows.
# Usage: deploy/grafana/pictures.sh [PROGRAM] [options of `tessera serve`]
# Needs Debian's packages chromium, fonts-inter and prometheus. The ports are those of run-local.sh and can be changed like them.
set -euo pipefail
cd "$(dirname "$0")/../.."
program=${1:-tessera}
[ $# -eq 0 ] || shift

# A limit on open files, storage and queues that a load of five minutes comes near to.
ulimit -n 1024
SCRAPE_INTERVAL=5s deploy/run-local.sh "$program" --ephemeral --blobs-mib 64 --memory-mib 32 --jobs-at-once 2 --waiting-jobs 12 \
    --queue-jobs 6 --probe-s 10 "$@" &
server=$!
trap 'kill "$server" 2>/dev/null; wait' EXIT
sleep 15

there="--endpoint http://127.0.0.1:${TESSERA_PORT:-50051} --quiet"
# What callers ask. The second is for the GPU, if there is one.
load() {
    "$program" load $there --tenants 4 --cancel 8 --backend parallel --mix remesh-job=4,remesh=3,rvd=2,rvd-job=2,cvt=1,info=2 "$@"
}
beside() {
    "$program" load $there --tenants 2 --mix rvd=2,remesh-job=1,cvt=1 --facets 500..1500 --rate 0.6 --duration-s "$1" --seed "$1"
}
beside 270 &
load --rate 2 --ramp-s 20 --duration-s 90 --facets 500..4000 --keep --seed 1
# More than two jobs at once can do: callers are refused.
load --rate 8 --duration-s 40 --facets 2000..8000 --slow-readers 3 --seed 2
load --rate 2 --duration-s 100 --facets 500..4000 --keep --seed 3 &
# The pictures are taken while there is work.
sleep 95
end=$(date +%s)
picture() {
    deploy/grafana/preview.py --prometheus "http://127.0.0.1:${PROMETHEUS_PORT:-9091}" --minutes 4.6 --end "$end" \
        --rows "$2" --picture "docs/images/dashboard-$1.png"
}
mkdir -p docs/images
picture jobs 'Now,Jobs,Device'
picture calls 'Calls,Refusals and health'
picture storage 'Storage and memory'
