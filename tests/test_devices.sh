#!/bin/sh
# hairgrad devices and --device: what is said where there is no GPU, and that every command that computes takes one.
# Usage: test_devices.sh BUILD
set -eu
hairgrad=$1/hairgrad
emulator=$1/tests/emulator
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

fail() { echo "FAILED: $*" >&2; exit 1; }

# It must end with $1 and one sentence that has $2 in it.
refuses() {
    code=$1; text=$2; shift 2
    set +e
    "$@" > out 2> err
    got=$?
    set -e
    [ "$got" = "$code" ] || fail "$*: ended with $got, expected $code: $(cat err)"
    grep -qF -- "$text" err || fail "$*: \"$text\" is not in: $(cat err)"
    [ "$(grep -c . err)" = 1 ] || fail "$*: more than one sentence: $(cat err)"
}

"$hairgrad" devices > out || fail "devices"
grep -Eq '^cpu +[0-9]+ threads' out || fail "devices: no cpu in: $(cat out)"
grep -Eq '^cuda(:0)? +' out || fail "devices: nothing of cuda in: $(cat out)"
"$hairgrad" devices --json > devices.json || fail "devices --json"
if command -v python3 > /dev/null; then
    python3 - <<'PYTHON' || fail "devices --json: $(cat devices.json)"
import json
cpu, *others = json.load(open("devices.json"))
assert cpu["name"] == "cpu" and cpu["memory"] > 0 and cpu["why_not"] == "" and others
assert all(o["name"].startswith("cuda") and (o["why_not"] or o["memory"] > 0) for o in others)
PYTHON
fi

for command in train evaluate drape loss gradcheck profile fit replay export; do
    "$hairgrad" $command --help | grep -q -- '--device NAME' || fail "$command has no --device"
done
refuses 2 'unknown option "--device"' "$hairgrad" make bust --device cpu -o bust.h5
refuses 1 'device "gpu" is not known: cpu, cuda, cuda:NUMBER and auto are' "$hairgrad" gradcheck stretch --device gpu
echo 'losses: { gravity: {} }' > recipe.yaml
for words in "train recipe.yaml -o run" "evaluate run" "drape run -o d.vtkhdf" "profile recipe.yaml" "export run --to onnx -o m.onnx" "loss stretch none.h5 -o out.h5" "fit material run d.vtkhdf"; do
    # shellcheck disable=SC2086
    refuses 1 'device "gpu" is not known' "$hairgrad" $words --device gpu
done
"$hairgrad" gradcheck matmul --device cpu > /dev/null || fail "gradcheck --device cpu"
"$hairgrad" gradcheck matmul --device auto > /dev/null || fail "gradcheck --device auto"
if grep -q '^cuda .*not usable: ' out; then
    why=$(sed -n 's/^cuda .*not usable: //p' out)
    refuses 1 "cuda: $why" "$hairgrad" gradcheck matmul --device cuda
fi

# On the emulated device, where there is one.
if [ -f "$emulator/libcuda.so.1" ]; then
    LD_LIBRARY_PATH=$emulator
    export LD_LIBRARY_PATH
    "$hairgrad" devices > out
    grep -q '^cuda .*emulated GPU, compute capability' out || fail "devices, emulated: $(cat out)"
    grep -q 'driver for CUDA 13.0, NVRTC ' out || fail "devices, emulated: $(cat out)"
    "$hairgrad" gradcheck matmul --device cuda > /dev/null || fail "gradcheck --device cuda"
    refuses 1 'cuda: device 1 was asked for, but there is 1' "$hairgrad" gradcheck matmul --device cuda:1
    EMULATOR_NO_DEVICE=1 "$hairgrad" devices > out
    grep -q '^cuda .*not usable: the NVIDIA driver found no GPU that it can use' out || fail "no GPU: $(cat out)"
    EMULATOR_NO_DEVICE=1 "$hairgrad" gradcheck matmul --device auto > /dev/null || fail "--device auto without a GPU"

    # A short training and what it is judged by: the same bits in every order of threads, and what the processor says.
    cat > recipe.yaml <<'END'
scene: { strands: 20, vertices: 6, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [turn] }
model: { width: 16 }
features: { history: 2, latent: 4, lock_size: 16, encoder_width: 16, encoder_steps: 10 }
losses: { stretch: {}, bend_twist: {}, gravity: {}, inertia: {}, body_collision: {} }
training: { strands: 16, frames: 2, steps: 6, warm_up: 2, log_every: 2, validate_every: 6, checkpoint_every: 6, validation_frames: 2 }
END
    for order in 0 1 2; do
        EMULATOR_ORDER=$order "$hairgrad" train recipe.yaml --device cuda -o run$order > log 2>&1 || fail "train --device cuda: $(cat log)"
        EMULATOR_ORDER=$order "$hairgrad" evaluate run$order --device cuda --frames 3 --json $order.json > table 2> log || fail "evaluate --device cuda: $(cat log)"
    done
    "$hairgrad" evaluate run0 --device cpu --frames 3 --json cpu.json > cpu.table 2> log || fail "evaluate --device cpu: $(cat log)"
    command -v python3 > /dev/null || exit 0
    python3 - <<'PYTHON' || fail "evaluate on the emulated device: see above"
import json
def numbers(value, at=""):
    if isinstance(value, dict):
        return {k: v for key in value for k, v in numbers(value[key], at + "." + key).items()}
    if isinstance(value, list):
        return {k: v for i, item in enumerate(value) for k, v in numbers(item, "%s[%d]" % (at, i)).items()}
    timed = any(word in at for word in ("time", "second", "ms", "rate", "per_s"))
    return {at: float(value)} if isinstance(value, (int, float)) and not isinstance(value, bool) and not timed else {}
first, second, third, cpu = (numbers(json.load(open(name + ".json"))) for name in ("0", "1", "2", "cpu"))
assert len(first) > 5, first
assert first == second == third, [(k, first[k], second.get(k), third.get(k)) for k in first if not first[k] == second.get(k) == third.get(k)]
least = lambda k: 1e-9 if "joule" in k or "terms" in k else 1
off = {k: (first[k], v) for k, v in cpu.items() if abs(first[k] - v) > 1e-3 * max(abs(v), least(k))}
assert not off, off
PYTHON
else
    echo "skip: there is no emulated device here"
fi
