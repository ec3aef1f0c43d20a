#!/bin/sh
# hairgrad train: Ctrl-C leaves a run that goes on, and the result is that of a run that was not stopped; a folder that
# holds a run is not overwritten; evaluate and drape take what was trained.
set -eu
build=$1
program=$build/hairgrad
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

fail() { printf '%s\n' "$*" >&2; exit 1; }

train() { # RUN OPTION...
    run=$1; shift
    "$program" train "$HG_SOURCE/examples/recipes/demo.yaml" -o "$folder/$run" --set scene.strands=200 --set scene.seconds=2 \
        --set training.strands=64 --set features.encoder_steps=20 --set training.steps=1200 --set training.checkpoint_every=100 \
        --set model.width=48 "$@"
}

train whole --threads 1 >"$folder/whole.txt" 2>/dev/null || fail "training failed"
grep -q 'trained 1200 steps' "$folder/whole.txt" || fail "not trained to the end"
train whole >/dev/null 2>"$folder/refused.txt" && fail "a run was overwritten"
grep -q -- '--resume' "$folder/refused.txt" || fail "the refusal does not say what to do"

train parts --threads 2 >"$folder/parts.txt" 2>/dev/null &
trainer=$!
while [ ! -f "$folder/parts/checkpoint.h5" ] && kill -0 "$trainer" 2>/dev/null; do sleep 0.05; done
kill -INT "$trainer" 2>/dev/null || true
wait "$trainer" || fail "an interrupted run did not end well"
train parts --resume >/dev/null 2>&1 || fail "the run does not go on"

# The best weights are the same bits when every metric is the same text.
for run in whole parts; do
    "$program" evaluate "$folder/$run" --frames 20 --json "$folder/$run.json" >"$folder/$run.table" 2>/dev/null || fail "evaluate failed"
done
cmp -s "$folder/whole.json" "$folder/parts.json" || fail "the interrupted run is another one"
grep -q '"inside_percent"' "$folder/whole.json" || fail "metrics.json has no metrics"

"$program" drape "$folder/whole" --clip shake --frames 3 -o "$folder/drape.vtkhdf" --body-out "$folder/body.vtkhdf" >/dev/null 2>&1 ||
    fail "drape failed"
[ -s "$folder/drape.vtkhdf" ] && [ -s "$folder/body.vtkhdf" ] || fail "no drape"
"$program" train "$HG_SOURCE/examples/recipes/demo.yaml" -o "$folder/bad" --set training.stepz=3 2>"$folder/bad.txt" && fail "a wrong key was taken"
grep -q 'steps' "$folder/bad.txt" || fail "the nearest right key is not named"
[ ! -e "$folder/bad" ] || fail "a refused config left a folder behind"
