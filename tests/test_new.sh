#!/bin/sh
# `hairgrad new`: what it writes builds by the line in its own comment, without a warning, and its gradient is right; so does
# the text in examples/new it is made from; nothing is overwritten. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" PATH="$build:$PATH" HAIRGRAD_CACHE="$work/cache" ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}verify_asan_link_order=0"
cd "$work" || exit 1

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' log; failed=1; }
try() { label=$1; shift; if "$@" >log 2>&1; then ok "$label"; else wrong "$label"; fi; }
refused() { # LABEL WORDS COMMAND...
    label=$1 words=$2; shift 2
    "$@" >log 2>&1; [ $? = 1 ] && [ "$(wc -l <log)" = 1 ] && grep -q "$words" log && ok "$label" || wrong "$label"
}
built() { # FILE: by the line that stands in it, and no compiler has a word to say
    line=$(sed -n 's/^ \*  *\(cc -shared .*\)$/\1/p' "$1")
    sh -c "$line -Wall -Wextra -Werror" >log 2>&1 && [ ! -s log ] && ok "$1: $line" || wrong "$1: $line"
}

cat >own.yaml <<'END'
scene: { style: straight, strands: 60, vertices: 8, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [nod] }
model: { width: 16, pinned: 2 }
features: { history: 2, encoder_width: 16, encoder_steps: 2 }
losses: { stretch: {}, gravity: {} }
training: { strands: 30, frames: 1, steps: 2, validate_every: 2, checkpoint_every: 2 }
END
for kind in energy op model; do
    cp "$source/examples/new/$kind.c" "my_$kind.c"
    built "my_$kind.c"
    try "new $kind" hairgrad new $kind "own_$kind"
    if grep -q "my_$kind" "own_$kind.c"; then cp "own_$kind.c" log; wrong "the name is everywhere"; fi
    built "own_$kind.c"
    cp "own_$kind.c" before.c
    refused "own_$kind.c is not overwritten" "stays as it is" hairgrad new $kind "own_$kind"
    cmp -s before.c "own_$kind.c" && ok "own_$kind.c is as it was" || wrong "own_$kind.c is as it was"
done
try "gradcheck of the energy" hairgrad --plugin own_energy.so gradcheck own_energy
try "gradcheck of the op" hairgrad --plugin own_op.so gradcheck own_op
if [ -d "$build/tests/emulator" ]; then # the same text for a GPU, here an emulated one
    LD_LIBRARY_PATH="$build/tests/emulator:$LD_LIBRARY_PATH"
    try "gradcheck of the op on a GPU" hairgrad --plugin own_op.so gradcheck own_op --device cuda
fi
try "all three at once" hairgrad --plugin own_energy.so --plugin own_op.so losses own_energy --plugin own_model.so
try "train with the energy" hairgrad --plugin own_energy.so train own.yaml -o run --set losses.own_energy.stiffness="2e-3 N"
try "train the model" hairgrad --plugin own_model.so train own.yaml -o run2 --set model.kind=own_model
try "evaluate the model" hairgrad --plugin own_model.so evaluate run2
refused "evaluate without it names it" 'no architecture "own_model".*--plugin' hairgrad evaluate run2
try "into another file" hairgrad new energy another -o somewhere.c
[ -f somewhere.c ] && grep -q 'HG_ENERGY(another' somewhere.c && ok "somewhere.c" || wrong "somewhere.c"
refused "of nothing known" 'did you mean "energy"' hairgrad new enrgy tip
refused "a word of C" "name of C" hairgrad new energy while
refused "a short name of formulas" "name of C" hairgrad new energy norm
refused "two words" "name of C" hairgrad new energy "two words"
refused "a known name" 'energy "stretch" already' hairgrad new energy stretch
refused "no such folder" "cannot be made" hairgrad new energy another -o nowhere/another.c
exit $failed
