#!/bin/sh
# Every recipe is one: its keys, units and energies are right, a few steps of it lower nothing to what is not a number, and its run
# is evaluated. Scenes are made small; those of files are replaced by the procedural bust. So are the variants of bench/ablation.sh.
set -eu
build=$1
source=${HG_SOURCE:-$(cd "$(dirname "$0")/.." && pwd)}
program=$build/hairgrad
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { printf 'not ok %s\n' "$*" >&2; cat "$work/log" >&2 2>/dev/null || true; exit 1; }

small="scene.folder= scene.body= scene.groom= scene.motions=[] scene.held_out=[] scene.motion_kinds=[nod] scene.held_out_kinds=[turn]
    scene.strands=80 scene.vertices=9 scene.seconds=1 scene.varied=0 scene.mirror=false features.encoder_steps=5 features.encoder_width=8
    model.width=8 training.strands=40 training.steps=4 training.warm_up=1 training.validate_every=2 training.validation_frames=2
    training.checkpoint_every=0 training.log_every=1 training.backend=interpreter training.start_from="
for recipe in "$source"/examples/recipes/*.yaml; do
    name=$(basename "$recipe" .yaml)
    set --
    for s in $small; do set -- "$@" --set "$s"; done
    grep -q LeftArm "$recipe" && set -- "$@" --set 'features.pose_joints=[Head, Neck]' # a joint of CMU's skeleton
    grep -q 'texture:' "$recipe" && set -- "$@" --set model.texture=16 --set model.depth=1 --set model.groups=0
    "$program" train "$recipe" -o "$work/run" "$@" >"$work/log" 2>&1 || fail "$name: training"
    grep -Eiq '(nan|inf)[,}]' "$work/run/log.jsonl" && fail "$name: a number that is none"
    "$program" evaluate "$work/run" --frames 3 --json "$work/run.json" >"$work/log" 2>&1 || fail "$name: evaluation"
    grep -q curl_of_rest "$work/run.json" || fail "$name: no curl"
    rm -rf "$work/run"
    # What stands in a comment of a recipe after "--set" or "losses." is a key too.
    for key in $(sed -n 's/^#.*--set \([a-z_.]*\)=.*/\1/p' "$recipe"); do
        case $key in losses.*|scene.*|model.*|training.*|features.*) ;; *) fail "$name: its remarks name $key" ;; esac
    done
    echo "ok $name"
done

cd "$work"
set -- scene.strands=80 scene.vertices=9 scene.seconds=1 features.encoder_steps=5 features.encoder_width=8 model.width=8 training.strands=40 \
    training.warm_up=1 training.validation_frames=2 training.backend=interpreter
OUT=$work/out SET="$*" FRAMES=4 sh "$source/bench/ablation.sh" "$build" 4 "1" >"$work/table" 2>"$work/log" || fail "bench/ablation.sh"
[ "$(awk 'NR > 1 && NF == 11' "$work/table" | wc -l)" = 16 ] || { cat "$work/table"; fail "a table of 16 variants"; }
grep -qi nan "$work/table" && { cat "$work/table"; fail "a number of the table that is none"; }
# Again: nothing is trained, and the table is the same.
OUT=$work/out SET="$*" FRAMES=4 sh "$source/bench/ablation.sh" "$build" 4 "1" base rods pose_reg >"$work/again" 2>"$work/log" || fail "bench/ablation.sh again"
for v in base rods pose_reg; do
    [ "$(grep "^$v " "$work/table" | awk '{ $6 = ""; print }')" = "$(grep "^$v " "$work/again" | awk '{ $6 = ""; print }')" ] || fail "another row of $v"
done
sh "$source/bench/ablation.sh" "$build" 4 "1" nonsense >"$work/log" 2>&1 && fail "an unknown variant was taken"
grep -q 'there is no variant nonsense' "$work/log" || fail "an unknown variant is not named"
echo "ok bench/ablation.sh"
