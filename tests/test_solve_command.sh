#!/bin/sh
# hairgrad solve, through the program, on the procedural scene. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(cd "$(dirname "$0")/.." && pwd)} failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" OMP_NUM_THREADS=2
program=$build/hairgrad
cd "$work" || exit 1

says() { # NAME STATUS PART COMMAND...: it ends with STATUS and says PART
    name=$1 expected=$2 part=$3; shift 3
    "$@" >out 2>err; status=$?
    if [ "$status" != "$expected" ]; then echo "not ok $name: status $status"; sed 's/^/    /' out err; failed=1
    elif ! grep -qE -e "$part" out err; then echo "not ok $name: no \"$part\""; sed 's/^/    /' out err; failed=1
    elif [ -n "$(find . -name '*.part-*')" ]; then echo "not ok $name: a temporary file is left"; failed=1
    else echo "ok $name"; fi
}
gone() { if [ -e "$2" ]; then echo "not ok $1: $2 is there"; failed=1; else echo "ok $1"; fi; }
holds() { # NAME EXPRESSION: true of result.json, by awk on its lines "key": value
    if awk -F'[:,]' '{ gsub(/[" ]/, "", $1); v[$1] = $2 + 0 } END { exit !('"$2"') }' result.json; then echo "ok $1"
    else echo "not ok $1"; sed 's/^/    /' result.json; failed=1; fi
}

sed -e 's/strands: 2000/strands: 120/' -e 's/vertices: 25/vertices: 16/' -e 's/seconds: 10 s/seconds: 1 s/' \
    -e 's/strands: 512/strands: 40/' -e 's/history: 10/history: 2/' "$source/examples/recipes/demo.yaml" >recipe.yaml

says "at rest" 0 'energy +minimum' "$program" solve recipe.yaml --clip shake --frames 2 -o still.vtkhdf --body-out body.vtkhdf --json result.json
holds "below the posed groom" 'v["energy_joule_per_strand"] < v["energy_posed_joule_per_strand"]'
holds "nearly all at their minimum" 'v["solves"] == 80 && v["converged"] + v["stalled"] == 80 && v["converged"] >= 72'
holds "edges keep their lengths" 'v["length_error_percent"] < 0.5'
if grep -q inertia result.json; then echo "not ok inertia is left out at rest"; failed=1; else echo "ok inertia is left out at rest"; fi
says "the drape is one" 0 'VTKHDF/Points +1280 3' "$program" info still.vtkhdf
says "moving" 0 'inertia' "$program" solve recipe.yaml --clip shake --frames 3 --strands 20 --dynamic -o moving.vtkhdf --json result.json
holds "moving, nearly all" 'v["solves"] == 60 && v["converged"] >= 50'
"$program" solve recipe.yaml --clip shake --frames 3 --strands 20 --dynamic -o once.vtkhdf --threads 1 >/dev/null 2>&1
if cmp moving.vtkhdf once.vtkhdf; then echo "ok the same with one thread"; else echo "not ok the same with one thread"; failed=1; fi
says "Adam does not get there" 0 '^0 of 10 strands' "$program" solve recipe.yaml --clip shake --frames 1 --strands 10 --method adam --evaluations 50
says "xpbd" 0 'energy +xpbd' "$program" solve recipe.yaml --clip shake --frames 2 --strands 40 --method xpbd --json result.json --set losses.bend_twist.weight=0 --set losses.bend_twist_chain.weight=1
holds "nearly all at rest" 'v["solves"] == 80 && v["converged"] >= 70 && v["energy_joule_per_strand"] < v["energy_posed_joule_per_strand"]'
says "xpbd moving" 0 'in the first frame' "$program" solve recipe.yaml --clip shake --frames 3 --strands 20 --dynamic --method xpbd --substeps 4 -o moving.vtkhdf
says "xpbd with sweeps, strands apart" 0 'energy +xpbd' "$program" solve recipe.yaml --clip shake --frames 2 --strands 20 --dynamic --method xpbd --sweeps --steps 5 --strand-distance "0.2 mm"
says "what xpbd has no constraint for" 0 'without a constraint of xpbd: adhesion' "$program" solve recipe.yaml --clip shake --frames 1 --strands 20 --method xpbd --set losses.adhesion.weight=1
rods="--set losses.cosserat_stretch_shear.weight=1 --set losses.cosserat_bend_twist.weight=1 --set losses.unit_quaternion.weight=100"
says "orientations" 0 'cosserat_bend_twist' "$program" solve recipe.yaml --clip shake --frames 2 --strands 10 --dynamic --json result.json $rods --set losses.bend_twist.weight=0 --set losses.stretch.weight=0
holds "rods at their minimum" 'v["solves"] == 20 && v["converged"] >= 16 && v["length_error_percent"] < 3'
says "orientations by xpbd" 0 'cosserat_bend_twist' "$program" solve recipe.yaml --clip shake --frames 1 --strands 10 --method xpbd $rods --set losses.bend_twist.weight=0 --set losses.stretch.weight=0
says "sweeps of another method" 1 'belongs to --method xpbd' "$program" solve recipe.yaml --sweeps
says "help" 0 'dynamic' "$program" solve --help
says "an unknown method" 1 'method newton: lbfgs, adam or xpbd' "$program" solve recipe.yaml --method newton -o no.vtkhdf
says "no time in it" 1 'knows of time' "$program" solve recipe.yaml --dynamic --frames 2 --set losses.inertia.weight=0 --set losses.drag.weight=0 -o no.vtkhdf
says "a frame that is not there" 1 'the motion has' "$program" solve recipe.yaml --first 9999 -o no.vtkhdf
says "a clip that is not there" 1 'no clip "swim"' "$program" solve recipe.yaml --clip swim -o no.vtkhdf
says "a recipe that is not there" 1 'missing.yaml' "$program" solve missing.yaml -o no.vtkhdf
says "a number that is none" 1 'whole number' "$program" solve recipe.yaml --frames many -o no.vtkhdf
says "Ctrl-C" 1 'interrupted; nothing was written' timeout --preserve-status -s INT 1 "$program" solve recipe.yaml --method adam --evaluations 1000000000 -o no.vtkhdf
gone "nothing is written then" no.vtkhdf
exit $failed
