#!/bin/sh
# hairgrad train --dry-run writes nothing; several grooms, materials, fine-tuning, factored export and fit from the command line.
set -eu
build=$1
program=$build/hairgrad
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() { printf '%s\n' "$*" >&2; cat "$folder/log" >&2 2>/dev/null || true; exit 1; }

cat >"$folder/recipe.yaml" <<END
scene: { grooms: [wavy, short], strands: 60, vertices: 9, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [turn] }
model: { width: 16, output: directions, pinned: 2 }
features: { history: 2, latent: 4, lock_size: 16, encoder_width: 16, encoder_steps: 20, materials: { bend_twist: { stiffness: [1e-9, 1e-7] } } }
losses: { stretch: {}, bend_twist: { stiffness: 1e-8 N*m^2 }, gravity: {}, inertia: {}, body_collision: {} }
training: { strands: 40, frames: 2, steps: 30, warm_up: 3, validate_every: 10, checkpoint_every: 10, ema: 0.9, tensorboard: true }
END

(cd "$folder" && "$program" train recipe.yaml --dry-run >dry.txt 2>log) || fail "no dry run"
[ "$(ls "$folder" | tr '\n' ' ')" = "dry.txt log recipe.yaml " ] || fail "a dry run left something behind: $(ls "$folder")"
for word in 'wavy' 'short' 'materials .*bend_twist.stiffness' 'first.weight' 'back end' 'a step'; do
    grep -q "$word" "$folder/dry.txt" || fail "the dry run does not say: $word"
done
"$program" train "$folder/recipe.yaml" --dry-run --set features.materials.bend_twist.stiffness='[1e-7, 1e-6]' >/dev/null 2>"$folder/log" && fail "a wrong range was taken"
grep -q 'recipe.yaml' "$folder/log" || fail "the file of the wrong range is not named"

"$program" train "$folder/recipe.yaml" -o "$folder/run" >"$folder/log" 2>&1 || fail "training failed"
ls "$folder"/run/events.out.tfevents.* >/dev/null 2>&1 || fail "no events"
for groom in wavy short long; do
    "$program" evaluate "$folder/run" --groom "$groom" --frames 3 --material 'bend_twist.stiffness=2e-9 N*m^2' >"$folder/log" 2>&1 || fail "evaluate --groom $groom failed"
done
"$program" evaluate "$folder/run" --frames 3 --set losses.inertia.weight=0 >"$folder/other.txt" 2>"$folder/log" || fail "evaluate --set failed"
grep -q '^inertia' "$folder/other.txt" && fail "an energy that was taken out is still there"
"$program" evaluate "$folder/run" --material bend_twist.stiffness=1 >/dev/null 2>"$folder/log" && fail "a material out of its range was taken"
grep -q '1e-07' "$folder/log" || fail "the range is not said"
"$program" evaluate "$folder/run" --groom wavvy >/dev/null 2>"$folder/log" && fail "an unknown groom was taken"
"$program" drape "$folder/run" --groom short --frames 4 -o "$folder/drape.vtkhdf" --body-out "$folder/body.vtkhdf" >"$folder/log" 2>&1 || fail "drape --groom failed"

"$program" export "$folder/run" --form factored -o "$folder/model.onnx" >"$folder/log" 2>&1 || fail "export --form factored failed"
[ -s "$folder/model.strand.onnx" ] && [ -s "$folder/model.frame.onnx" ] || fail "the two graphs are not there"
"$program" export "$folder/run" --form factored --to h5 -o "$folder/model.h5" >/dev/null 2>"$folder/log" && fail "a factored h5 was promised"

# Fine-tuning on another groom; a network of another width is refused by name.
"$program" train "$folder/recipe.yaml" -o "$folder/fine" --set scene.grooms='[curly]' --set training.start_from="$folder/run" --set training.steps=10 >"$folder/log" 2>&1 || fail "fine-tuning failed"
"$program" train "$folder/recipe.yaml" -o "$folder/wide" --set model.width=17 --set training.start_from="$folder/run" >/dev/null 2>"$folder/log" && fail "another width was taken"
grep -q 'first.weight' "$folder/log" || fail "the mismatch is not named"

# A network's drape is not at rest: the answer is a number, or that the drape is not in balance. Another groom is refused.
"$program" fit material "$folder/recipe.yaml" "$folder/drape.vtkhdf" --groom short >"$folder/fit.txt" 2>"$folder/log" || grep -q 'fit: ' "$folder/log" || fail "fit says nothing"
"$program" fit material "$folder/recipe.yaml" "$folder/drape.vtkhdf" --groom wavy >/dev/null 2>"$folder/log" && fail "a drape of another groom was taken"
grep -q 'another groom' "$folder/log" || fail "it is not said that the groom is another"
