#!/bin/sh
# Remeshes four surfaces with the defaults and prints their quality as a Markdown table.
# Usage: TESSERA_MESHES=FOLDER tests/quality-table.sh [OPTION...]
#        TESSERA_MESHES=FOLDER tests/quality-table.sh --check
# Options go to `tessera remesh`, e.g. --density curvature. TESSERA names another program than `tessera`.
# With --check the tables of docs/quality.md are made again, and each line must be in the document.
set -eu

if [ "${1:-}" = --check ]; then
    if [ -z "${TESSERA_MESHES:-}" ]; then
        echo "TESSERA_MESHES is not set: THE TABLES OF docs/quality.md ARE NOT CHECKED"
        exit 0
    fi
    for density in uniform curvature lfs; do
        table=$("$0" --density "$density")
        if missing=$(printf '%s\n' "$table" | grep -vxFf "$(dirname "$0")/../docs/quality.md"); then
            printf 'docs/quality.md has other figures (%s):\n%s\n' "$density" "$missing" >&2
            exit 1
        fi
    done
    echo "as the commands give them"
    exit 0
fi

meshes=${TESSERA_MESHES:?is the folder with stanford-bunny.obj, rocker-arm.obj, fandisk.obj and nefertiti.obj}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

while read -r mesh points; do
    "${TESSERA:-tessera}" remesh "$meshes/$mesh.obj" --points "$points" \
        --backend parallel -o "$work/$mesh.ply" --report "$work/$mesh-$points.json" --quiet "$@" </dev/null
done <<END
stanford-bunny 10000
rocker-arm 5000
fandisk 3000
nefertiti 50000
END

python3 - "$work" <<'END'
import json
import sys

print("| mesh, points | Q min | Q mean | smallest angle | under 30° | valence 5-7 | Hausdorff | RMS |")
print("| --- | --- | --- | --- | --- | --- | --- | --- |")
for mesh, points in [("stanford-bunny", 10000), ("rocker-arm", 5000), ("fandisk", 3000), ("nefertiti", 50000)]:
    with open(f"{sys.argv[1]}/{mesh}-{points}.json", encoding="utf-8") as file:
        r = json.load(file)["result"]
    print(
        f"| {mesh}, {points:,} | {r['q_min']:.2f} | {r['q_avg']:.3f} | {r['theta_min_deg']:.1f}° "
        f"| {r['under_30_percent']:.3f} % | {r['v567_percent']:.2f} % "
        f"| {r['hausdorff_percent']:.3f} % | {r['rms_percent']:.3f} % |"
    )
END
