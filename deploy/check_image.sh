#!/bin/bash
# Runs the server of an image where no container engine is: on its file system, read-only, as its user, without capabilities.
# Usage: deploy/check_image.sh FOLDER [NAME=VALUE...]
# FOLDER is the mounted file system of an image, as of `buildah mount`. Needs root. The server does a job for the program of the same
# image, says that it is healthy, and ends on SIGTERM. NAME=VALUE are variables for the server.
set -euo pipefail

root=$(realpath "${1:?usage: check_image.sh FOLDER [NAME=VALUE...]}")
shift
if [ -z "${TESSERA_CHECK_UNSHARED:-}" ]; then
    # Mounts of its own, which end with it.
    export TESSERA_CHECK_UNSHARED=1
    exec unshare --mount -- "$0" "$root" "$@"
fi
work=$(mktemp -d)
server=
stop() {
    [ -z "$server" ] || kill "$server" 2>/dev/null || true
    umount -R "$root" 2>/dev/null || true
    rm -rf "$work"
}
trap stop EXIT

mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
mount -t tmpfs -o mode=1777 tmpfs "$root/tmp"
mount -t tmpfs -o uid=10001,gid=10001,mode=0700 tmpfs "$root/var/lib/tessera"
mount -o remount,bind,ro "$root"
! touch "$root/etc/written" 2>/dev/null || { echo "the root can be written" >&2; exit 1; }

# What the image sets, but for the addresses: nothing here is for other machines.
variables=(PATH=/usr/local/bin:/usr/sbin:/usr/bin TESSERA_DATA_DIR=/var/lib/tessera TESSERA_LOG_FORMAT=json XDG_CACHE_HOME=/tmp "$@")
# chroot needs a capability, so they are dropped inside.
inside=(env -i "${variables[@]}" chroot "$root"
    setpriv --reuid 10001 --regid 10001 --clear-groups --bounding-set=-all --inh-caps=-all --no-new-privs --)
run() { "${inside[@]}" "$@"; }
run tessera doctor
: >"$work/out"
"${inside[@]}" tessera serve --listen 127.0.0.1:0 --admin-listen 127.0.0.1:0 >"$work/out" 2>"$work/log" &
server=$!
for _ in $(seq 300); do
    [ "$(wc -l <"$work/out")" -lt 2 ] || break
    kill -0 "$server" 2>/dev/null || { cat "$work/log" >&2; exit 1; }
    sleep 0.1
done
calls=$(sed -n 's/^tessera listens on //p' "$work/out")
admin=$(sed -n 's/^tessera tells operators on //p' "$work/out")

run tessera health --admin "$admin"
run tessera info --endpoint "http://$calls"
run tessera shape genus3 --facets 20000 -o /tmp/in.obj
time run tessera remesh /tmp/in.obj --points 4000 -o /tmp/out.ply --endpoint "http://$calls" --quiet
run sh -c 'test -s /tmp/out.ply'
job=$(run tessera jobs submit remesh /tmp/in.obj --points 2000 --endpoint "http://$calls")
run tessera jobs wait "$job" --endpoint "http://$calls"
run tessera jobs fetch "$job" -o /tmp/job.ply --endpoint "http://$calls"
# Others are served with TLS and keys alone.
code=0
run tessera serve --listen 0.0.0.0:0 >/dev/null 2>&1 || code=$?
[ "$code" -eq 2 ] || { echo "it listens to others without TLS: $code" >&2; exit 1; }

kill -TERM "$server"
code=0
wait "$server" || code=$?
server=
[ "$code" -eq 0 ] || { echo "the server ended with $code" >&2; cat "$work/log" >&2; exit 1; }
echo "ok"
