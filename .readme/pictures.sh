#!/bin/sh
# Draws the pictures of README.md (.readme/), docs/first-steps.md and docs/regions.md (docs/images/) with the program's own --picture.
# Usage: TESSERA_MESHES=FOLDER .readme/pictures.sh
# FOLDER holds fandisk.obj. TESSERA names another program than `tessera`.
set -eu
cd "$(dirname "$0")/.."
root=$PWD
meshes=$(cd "${TESSERA_MESHES:?is the folder with fandisk.obj}" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/bin"
ln -s "$(realpath "$(command -v "${TESSERA:-tessera}")")" "$work/bin/tessera"
PATH=$work/bin:$PATH
cd "$work"

# The input, the cells of the result's vertices on the input, and the result, all seen from one side.
input=$meshes/fandisk.obj
tessera remesh "$input" --points 1500 -o after.obj --picture after.png --picture-size 800x600
sed -n 's/^v //p' after.obj >seeds.xyz
tessera measure "$input" --picture before.png --picture-size 800x600
tessera rvd "$input" --seeds seeds.xyz --picture cells.png --picture-size 800x600
for name in before cells after; do
    install -m 0644 "$name.png" "$root/.readme/$name.png"
done

# The commands of the page itself, with smaller pictures.
sed -n '/^```sh$/,/^```$/{/^```/d;p}' "$root/docs/first-steps.md" | sed 's/--picture [a-z]*\.png/& --picture-size 800x600/' >steps
sh -e steps
for name in ring even curved block near; do
    install -m 0644 "$name.png" "$root/docs/images/first-steps-$name.png"
done

# Regions, sheets that meet, and a periodic cell eight times.
python3 "$root/.readme/regions.py"
tessera remesh materials.obj --points 1500 -o out.obj --colour region --picture materials.png --picture-size 800x600
tessera remesh hole.obj --points 900 --keep ring -o out.obj --colour region --picture hole.png --picture-size 800x600
tessera remesh foam.obj --points 3000 --non-manifold keep -o out.obj --colour region --picture foam.png --picture-size 800x600
tessera remesh cell.obj --points 700 --periodic translate:1,0,0 --periodic translate:0,1,0 --periodic translate:0,0,1 -o out.obj
python3 "$root/.readme/regions.py" copies out.obj cells.obj
tessera measure cells.obj --picture cell.png --picture-size 800x600
for name in materials hole foam cell; do
    install -m 0644 "$name.png" "$root/docs/images/regions-$name.png"
done
