#!/bin/sh
# hairgrad loss from outside: against NumPy where there is one (HG_PYTHON names the interpreter, default python3); without
# it on files of the program's own. Traps of `loss`, `train` and `evaluate` write files that show what they say.
build=$1 source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
program=$build/hairgrad
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
cd "$folder" || exit 1

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' log; failed=1; }

python=${HG_PYTHON:-python3}
if "$python" -c 'import h5py, numpy' 2>/dev/null; then
    "$python" "$source/tests/reference/check_loss.py" "$program" "$folder" || failed=1
else
    echo "skip NumPy: $python has not both of h5py and numpy (HG_PYTHON names another interpreter)"
fi

# ---- a training that goes to infinity: the trap names the energy, and its file shows it again
cat >tiny.yaml <<'END'
scene: {strands: 40, vertices: 9, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [shake]}
model: {width: 16, depth: 1}
features: {history: 2, latent: 4, encoder_width: 16, encoder_steps: 5, lock_size: 8}
losses:
  stretch: {stiffness: 1e38 N/m}
  gravity: {}
training: {strands: 20, steps: 40, log_every: 5, validate_every: 20, checkpoint_every: 2, learning_rate: 1}
END
"$program" train tiny.yaml -o run --trap-nan >stdout 2>log
if [ $? != 1 ]; then wrong "train --trap-nan stops"
elif ! grep -q "energy 'stretch' of frame 0, strand [0-9]*: .* vertex [0-9]" log; then wrong "train --trap-nan names energy, strand and vertex"
elif ! grep -q 'run/nan.h5: hairgrad loss stretch run/nan.h5 -o out.h5 --dtype f32' log; then wrong "train --trap-nan says how to see it again"
else ok "train --trap-nan"; fi
if "$program" loss stretch run/nan.h5 -o out.h5 --dtype f32 >log 2>&1 && grep -q '^1 frames, 1 strands, 9 vertices' log && grep -qE '^stretch .*e\+' log
then ok "its file"; else wrong "its file"; fi
if "$program" replay run/nan.h5 >log 2>&1 && grep -q '^hairgrad loss stretch run/nan.h5' log; then ok "replay of an energy"; else wrong "replay of an energy"; fi

# ---- command lines that are wrong: one sentence, status 1, nothing is written
refused() { # NAME PART ARGUMENT...
    name=$1 part=$2; shift 2
    "$program" loss "$@" >stdout 2>log
    if [ $? != 1 ] || [ "$(grep -c '^hairgrad: ' log)" != 1 ] || ! grep -q -- "$part" log || [ -e none.h5 ]; then wrong "$name"; else ok "$name"; fi
}
refused "loss without output" '-o OUT.h5' stretch run/nan.h5
refused "loss of another dtype" 'there are f32 and f64' stretch run/nan.h5 -o none.h5 --dtype f16
refused "loss on another back end" 'auto, interpreter and compiled' stretch run/nan.h5 -o none.h5 --backend gpu
refused "loss of a file that is none" 'is not an HDF5 file' stretch tiny.yaml -o none.h5
refused "loss of a missing file" 'missing.h5: cannot be opened' stretch missing.h5 -o none.h5
refused "loss into its input" 'would replace the input' stretch run/nan.h5 -o run/nan.h5
refused "loss that cannot be written" 'cannot be written' stretch run/nan.h5 -o none/none.h5
refused "loss of an unknown energy" "did you mean 'stretch'" strech run/nan.h5 -o none.h5
refused "loss of an unknown setting" 'did you mean "stiffness"' stretch run/nan.h5 -o none.h5 --set stifness=2

# ---- the drawing of a step
if "$program" train tiny.yaml -o run --again --set "losses.stretch.stiffness=2 N/m" --set training.learning_rate=1e-3 --trap-nan --graph graph.dot >log 2>&1 &&
   grep -q '^digraph tape' graph.dot && grep -q '{physics|f32 \[\]|gradient' graph.dot; then ok "train --graph"; else wrong "train --graph"; fi
cp graph.dot first.dot 2>/dev/null
"$program" train tiny.yaml -o run --again --set "losses.stretch.stiffness=2 N/m" --set training.learning_rate=1e-3 --graph graph.dot >log 2>&1
if cmp first.dot graph.dot >>log 2>&1; then ok "the drawing is the same every time"; else wrong "the drawing is the same every time"; fi
if "$program" evaluate run --trap-nan --frames 3 >log 2>&1 && [ ! -e run/nan.h5 ]; then ok "evaluate --trap-nan has nothing to say"; else wrong "evaluate --trap-nan has nothing to say"; fi
exit $failed
