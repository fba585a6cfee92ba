#!/usr/bin/env bash
# Prints the table of results in docs/quality.md. TESSERA names the program, TESSERA_MESHES the folder with the meshes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for case in stanford-bunny:10000 rocker-arm:5000 fandisk:3000 nefertiti:50000; do
    name=${case%:*}
    "${TESSERA:-tessera}" remesh "$TESSERA_MESHES/$name.obj" --points "${case#*:}" --backend parallel --quiet \
        -o "$folder/$name.ply" --report "$folder/$name.json"
done
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
print("| mesh, vertices | Q min | Q mean | smallest angle | under 30° | valence 5-7 | Hausdorff | RMS |")
print("| --- | --- | --- | --- | --- | --- | --- | --- |")
for name in ["stanford-bunny", "rocker-arm", "fandisk", "nefertiti"]:
    r = json.loads((pathlib.Path(sys.argv[1]) / f"{name}.json").read_text())["result"]
    print(f"| {name}, {r['vertices']:,} | {r['q_min']:.2f} | {r['q_avg']:.3f} | {r['theta_min_deg']:.1f}° "
          f"| {r['under_30_percent']:.2f} % | {r['v567_percent']:.1f} % | {r['hausdorff_percent']:.2f} % | {r['rms_percent']:.3f} % |")
PYTHON
