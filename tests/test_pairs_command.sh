#!/bin/sh
# hairgrad drape --pairs: listed pairs are the frames of a drape, drawn ones are written down so that they can be draped again,
# each groom has its file, and what is wrong in a list is said with its line. $1 is the build folder.
build=$1 failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
hairgrad=$build/hairgrad
ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' log; failed=1; }
try() { label=$1; shift; if "$@" >log 2>&1; then ok "$label"; else wrong "$label"; fi; }
refused() { # LABEL WORDS COMMAND...: fails with one line that has WORDS, and writes nothing
    label=$1 words=$2; shift 2
    if "$@" >log 2>&1; then wrong "$label"; return; fi
    if [ "$(grep -c '^hairgrad: ' log)" = 1 ] && grep -qF -- "$words" log && [ ! -e none.vtkhdf ] && [ ! -e none.pairs ]; then ok "$label"; else wrong "$label"; fi
}

cat >strands.yaml <<'END'
scene: { style: wavy, strands: 60, vertices: 7, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [turn] }
model: { width: 16 }
features: { history: 2, latent: 4, lock_size: 16, encoder_width: 16, encoder_steps: 10 }
losses: { stretch: {}, gravity: {}, inertia: {} }
training: { strands: 20, frames: 1, steps: 4, warm_up: 2, log_every: 2, validate_every: 4, checkpoint_every: 4, validation_frames: 2 }
END
cat >grooms.yaml <<'END'
scene: { grooms: [wavy, short], strands: 60, vertices: 7, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [turn] }
model: { kind: quaffure, texture: 16, width: 8, depth: 1 }
features: { latent: 4, encoder_width: 8, encoder_steps: 10 }
losses: { stretch: {}, gravity: {} }
training: { strands: 20, frames: 1, steps: 4, warm_up: 2, log_every: 2, validate_every: 4, checkpoint_every: 4, validation_frames: 2 }
END
for family in strands grooms; do "$hairgrad" train $family.yaml -o $family >log 2>&1 || { wrong "train $family"; exit 1; }; done

printf '# three frames\nwavy turn 3\nwavy\tturn 1500\t4\n\nwavy turn 5 0,0\n' >three
for family in strands grooms; do
    try "$family: listed pairs" "$hairgrad" drape $family --pairs three -o three.vtkhdf
    try "$family: the same frames" "$hairgrad" drape $family --groom wavy --clip turn --first 3 --frames 3 -o frames.vtkhdf
    try "$family: they are the same" cmp three.vtkhdf frames.vtkhdf
    [ -f three.pairs ] && [ "$(grep -c '# three.vtkhdf' three.pairs)" = 3 ] && ok "$family: the list" || wrong "$family: the list"
done

try "drawn pairs" "$hairgrad" drape grooms --pairs 30 --seed 7 -o drawn.vtkhdf --body-out body.vtkhdf
if [ -f drawn.wavy.vtkhdf ] && [ -f drawn.short.vtkhdf ] && [ -f body.wavy.vtkhdf ] && [ -f body.short.vtkhdf ] && [ ! -e drawn.vtkhdf ]; then ok "a file for each groom"
else ls >log; wrong "a file for each groom"; fi
try "the list again" "$hairgrad" drape grooms --pairs drawn.pairs -o again.vtkhdf --body-out body.vtkhdf
try "is the same" cmp drawn.wavy.vtkhdf again.wavy.vtkhdf
try "another seed" "$hairgrad" drape grooms --pairs 30 --seed 8 -o other.vtkhdf --body-out body.vtkhdf
if cmp -s drawn.pairs other.pairs; then echo "the same pairs" >log; wrong "another seed draws others"; else ok "another seed draws others"; fi
echo "curly nod 7 0.3,neck_length=-0.5" >unseen
try "a groom that was not trained on" "$hairgrad" drape grooms --pairs unseen -o unseen.vtkhdf
try "drawn pairs of a groom" "$hairgrad" drape strands --pairs 5 --groom curly --stride 7 -o curly.vtkhdf
try "its picture" "$hairgrad" render curly.vtkhdf -o curly.png

bad() { printf 'wavy turn 3\n%s\n' "$2" >list; refused "$1" "$3" "$hairgrad" drape grooms --pairs list -o none.vtkhdf; }
bad "no frame" "wavy turn" "list:2: expected GROOM CLIP FRAME"
bad "a frame that is no number" "wavy turn x" "list:2: expected GROOM CLIP FRAME"
bad "a frame behind the end" "wavy turn 9999" "list:2: frame 9999 of a motion of 31"
bad "no such groom" "wavvy turn 3" 'list:2: no procedural groom is called "wavvy"'
bad "no such clip" "wavy trun 3" 'list:2: the run has no clip "trun"'
bad "no such shape" "wavy turn 3 0.5,x" "list:2: shape 0.5,x"
: >list
refused "an empty list" "there is no pair in it" "$hairgrad" drape grooms --pairs list -o none.vtkhdf
refused "no list" "cannot be opened" "$hairgrad" drape grooms --pairs missing -o none.vtkhdf
refused "no pairs" "--pairs 0: 1 to" "$hairgrad" drape grooms --pairs 0 -o none.vtkhdf
refused "pairs and a clip" "either --pairs or --clip" "$hairgrad" drape grooms --pairs 3 --clip turn -o none.vtkhdf
exit $failed
