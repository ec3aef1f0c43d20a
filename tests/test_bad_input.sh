#!/bin/sh
# Bad input, through the program: one clear sentence on stderr, an exit status that is not zero and no signal, and every
# file that was there before is untouched. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
work=$(mktemp -d) || exit 1
trap 'chmod -R u+w "$work"; rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" OMP_NUM_THREADS=2
program=$build/hairgrad
cd "$work" || exit 1

ok() { echo "ok $1"; }
wrong() { echo "not ok $1: $2"; sed 's/^/    /' "$work/stderr"; failed=1; }
sums() { find keep -type f 2>/dev/null | LC_ALL=C sort | xargs -r cksum; }

refused() { # NAME PART COMMAND...: it says PART in one sentence and leaves keep/ alone
    name=$1 part=$2; shift 2
    before=$(sums)
    "$@" >"$work/stdout" 2>"$work/stderr"; status=$?
    lines=$(grep -c '^hairgrad' "$work/stderr")
    if [ "$status" = 0 ]; then wrong "$name" "it was accepted"
    elif [ "$status" -ge 126 ]; then wrong "$name" "it ended with status $status"
    elif [ "$lines" != 1 ]; then wrong "$name" "$lines sentences on stderr"
    elif ! grep -qE "$part" "$work/stderr"; then wrong "$name" "no \"$part\" in its sentence"
    elif [ "$before" != "$(sums)" ]; then wrong "$name" "it touched a file that was there"
    elif [ -n "$(find . -name '*.part-*')" ]; then wrong "$name" "a temporary file is left: $(find . -name '*.part-*')"
    else ok "$name"; fi
}

accepted() { # NAME PART COMMAND...: it works and says PART
    name=$1 part=$2; shift 2
    "$@" >"$work/stdout" 2>"$work/stderr"; status=$?
    if [ "$status" != 0 ]; then wrong "$name" "status $status"
    elif ! grep -qE "$part" "$work/stdout" "$work/stderr"; then cat "$work/stdout" >>"$work/stderr"; wrong "$name" "no \"$part\" in what it said"
    else ok "$name"; fi
}

mkdir keep bad
"$build/tests/bad_files" bad || exit 1
python3 "$source/tests/bad_files.py" bad || exit 1
"$program" make bust -o keep/bust.h5 >/dev/null && "$program" make groom --body keep/bust.h5 --strands 40 --vertices 9 -o keep/groom.h5 >/dev/null || exit 1
"$program" make motion --body keep/bust.h5 --kind nod --seconds 1 -o keep/motion.h5 >/dev/null || exit 1

cat >tiny.yaml <<'END'
scene: {strands: 40, vertices: 9, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [shake]}
model: {width: 16, depth: 1}
features: {history: 2, latent: 4, encoder_width: 16, encoder_steps: 5, lock_size: 8}
losses:
  stretch: {stiffness: 2 N/m}
  gravity: {}
training: {strands: 20, steps: 40, log_every: 5, validate_every: 20, checkpoint_every: 2}
END

# ---- command line
refused "unknown command" 'unknown command "trian"; did you mean "train"\?' "$program" trian
refused "unknown option" 'unknown option "--outptu"; did you mean "--output"\?' "$program" train tiny.yaml --outptu x
refused "missing argument" 'something is missing' "$program" train
refused "option without value" '(--output|-o) needs a value' "$program" train tiny.yaml -o
refused "number that is none" '"many" is not an integer' "$program" make groom --strands many -o keep/groom.h5
refused "unknown energy" 'unknown .*"strech"; did you mean "stretch"\?' "$program" gradcheck strech
refused "plug-in that is none" 'tiny.yaml: .*cannot be loaded|not a plug-in' "$program" --plugin tiny.yaml losses

# ---- configs
change() { sed "$1" tiny.yaml >changed.yaml; }
change 's/^training: {strands/training: {strnads/'; refused "misspelt key" 'changed.yaml:7: unknown key "training.strnads"; did you mean "strands"\?' "$program" train changed.yaml -o run
change 's/  stretch:/  strech:/'; refused "misspelt energy" 'changed.yaml:5: unknown key "losses.strech"; did you mean "stretch"\?' "$program" train changed.yaml -o run
change 's/stiffness: 2 N\/m/stiffness: 2 mm/'; refused "wrong unit" 'changed.yaml:5: .*has the unit mm, N/m is needed' "$program" train changed.yaml -o run
change 's/steps: 40/steps: forty/'; refused "wrong type" 'changed.yaml:7: .*"forty" is not an integer' "$program" train changed.yaml -o run
change 's/steps: 40/steps: 0/'; refused "out of range" 'changed.yaml:7: .*between 1 and' "$program" train changed.yaml -o run
change 's/^model:/scene: {}\nmodel:/'; refused "section twice" 'changed.yaml:2: section "scene" was already given in line 1' "$program" train changed.yaml -o run
change 's/\[nod\]/[nodd]/'; refused "unknown motion" 'nodd' "$program" train changed.yaml -o run
change 's/^model: {/model: {kind: neuralock, /'; refused "unknown network" 'neuralock' "$program" train changed.yaml -o run
printf 'scene: [unclosed\n' >changed.yaml; refused "not YAML" 'changed.yaml:2: not valid YAML' "$program" train changed.yaml -o run
refused "no recipe" 'missing.yaml: cannot be opened \(No such file or directory\)' "$program" train missing.yaml -o run
refused "zero mass" 'linear_density=0 kg/m: .* is out of range' "$program" train tiny.yaml -o run --set "scene.linear_density=0 kg/m"
refused "negative mass" 'linear_density=-1 kg/m: .* is out of range' "$program" train tiny.yaml -o run --set "scene.linear_density=-1 kg/m"
refused "misspelt override" 'unknown key "training.stpes"; did you mean "steps"\?' "$program" train tiny.yaml -o run --set training.stpes=3
change 's/history: 2,/history: 2, pose_joints: [Haed],/'; refused "unknown joint" 'changed.yaml:3: .*Haed' "$program" train changed.yaml -o run
change 's/^losses:/losses: {}\nnothing:/; /stretch/d; /gravity/d'; refused "no energy" '.' "$program" train changed.yaml -o run
refused "missing scene file of a recipe" 'missing.h5' "$program" train tiny.yaml -o run --set scene.groom=missing.h5
refused "missing motion of a recipe" 'missing.h5' "$program" train tiny.yaml -o run --set 'scene.motions=[missing.h5]'
refused "motion of other joints in a recipe" 'tiny.yaml: scene.motions: .*other_joints.h5: .*missing .*extra Tail' "$program" train tiny.yaml -o run --set "scene.motions=[$work/bad/other_joints.h5]"
refused "held-out motion of other joints" 'scene.held_out: .*other_joints.h5: .*extra Tail' "$program" train tiny.yaml -o run --set "scene.motions=[$work/keep/motion.h5]" --set "scene.held_out=[$work/bad/other_joints.h5]"
if [ -e run ]; then wrong "a recipe that is refused leaves no run folder" "$(find run)"; else ok "a recipe that is refused leaves no run folder"; fi

# ---- files that are missing
refused "missing groom file" 'missing.tfx: cannot be opened' "$program" import groom missing.tfx --body keep/bust.h5 -o keep/groom.h5
refused "missing body" 'missing.h5: cannot be opened' "$program" make groom --body missing.h5 -o keep/groom.h5
refused "missing body folder" 'missing' "$program" import body missing -o keep/bust.h5
refused "missing motion" 'missing.bvh: cannot be opened' "$program" import motion missing.bvh --body keep/bust.h5 -o keep/motion.h5
refused "missing run" 'missing' "$program" evaluate missing
refused "missing drape" 'missing.vtkhdf: cannot be opened' "$program" render missing.vtkhdf -o keep/x.png

# ---- files that lie
import_groom() { refused "$1" "$2" "$program" import groom "bad/$3" --body keep/bust.h5 -o keep/groom.h5; }
import_groom "truncated .tfx" 'truncated.tfx: .*bytes' truncated.tfx
import_groom ".tfx without its header" 'no_header.tfx: ' no_header.tfx
import_groom "empty .tfx" 'empty.tfx: ' empty.tfx
import_groom ".tfx that lies about its strands" 'lying_count.tfx: ' lying_count.tfx
import_groom ".tfx that lies about its points" 'lying_points.tfx: ' lying_points.tfx
import_groom ".tfx that lies about its offset" 'lying_offset.tfx: ' lying_offset.tfx
import_groom ".tfx without strands" 'zero_strands.tfx: .*0 strands' zero_strands.tfx
import_groom ".tfx of NaN" 'nan_all.tfx: ' nan_all.tfx
import_groom ".tfx of one-vertex strands" 'one_vertex.tfx: ' one_vertex.tfx
import_groom "groom of an unknown kind" 'tiny.yaml|\.yaml' ../tiny.yaml
accepted "NaN strand: dropped and said" '(1 .*not finite|not finite.*1|non-finite)' "$program" import groom bad/nan_one.tfx --body keep/bust.h5 -o bad/fitted.h5
accepted "zero-length strand: dropped and said" '(1 .*(without|no|zero).*length|zero-length|no length)' "$program" import groom bad/zero_length.tfx --body keep/bust.h5 -o bad/fitted.h5

import_motion() { refused "$1" "$2" "$program" import motion "bad/$3" --body keep/bust.h5 -o keep/motion.h5; }
import_motion "truncated .bvh" 'truncated.bvh' truncated.bvh
import_motion ".bvh that lies about its frames" 'lying.bvh' lying.bvh
import_motion ".bvh with a word" 'words.bvh.*two' words.bvh
import_motion ".bvh of NaN" 'nan.bvh' nan.bvh
import_motion ".bvh of other joints" 'other_joints.bvh|joint' other_joints.bvh
refused "broken .asf" 'broken.asf' "$program" import motion bad/broken.amc --skeleton bad/broken.asf --body keep/bust.h5 -o keep/motion.h5
printf 'PK\003\004 and no more' >bad/broken.npz; printf 'glTF\002' >bad/short.glb; printf '{"asset": {' >bad/broken.gltf
import_groom "broken .npz of strands" 'broken.npz: ' broken.npz
import_motion "broken .npz of a motion" 'broken.npz: ' broken.npz
refused "broken .npz of a body" 'broken.npz: .*directory' "$program" import body bad/broken.npz -o keep/bust.h5
import_motion "short .glb" 'short.glb: ' short.glb
refused "broken .gltf" 'broken.gltf: .*not valid JSON' "$program" import body bad/broken.gltf -o keep/bust.h5
refused "info of a broken file" 'broken.npz: no body .*no motion .*no strands' "$program" info bad/broken.npz
refused ".amc without skeleton" 'needs its skeleton' "$program" import motion bad/broken.amc --body keep/bust.h5 -o keep/motion.h5

head -c 3000 keep/groom.h5 >bad/truncated.h5
printf 'nonsense' >bad/nonsense.h5
pose() { refused "$1" "$2" "$program" pose --body "$3" --groom "$4" --motion "$5" -o keep/posed.h5; }
pose "truncated groom .h5" 'truncated.h5: ' keep/bust.h5 bad/truncated.h5 keep/motion.h5
pose "groom that is no .h5" 'nonsense.h5: is not an HDF5 file' keep/bust.h5 bad/nonsense.h5 keep/motion.h5
pose "groom of NaN" 'nan_groom.h5: ' keep/bust.h5 bad/nan_groom.h5 keep/motion.h5
pose "groom that lies" 'lying_groom.h5: .*root_face' keep/bust.h5 bad/lying_groom.h5 keep/motion.h5
pose "groom without strands" 'no_strands.h5: ' keep/bust.h5 bad/no_strands.h5 keep/motion.h5
pose "groom of a later version" 'new_version.h5: it has version 2 of its format; versions up to 1 can be read' keep/bust.h5 bad/new_version.h5 keep/motion.h5
pose "motion in place of a groom" 'other_kind.h5: ' keep/bust.h5 bad/other_kind.h5 keep/motion.h5
pose "motion of other joints" 'other_joints.h5: .*(Tail|joint)' keep/bust.h5 keep/groom.h5 bad/other_joints.h5
refused "body without a scalp" 'scalp' "$program" make groom --body bad/no_scalp.h5 -o keep/groom.h5

data=$source/../shared/data/bodies
if [ -d "$data" ]; then
    mkdir bodies && cp -r "$data/makehuman" "$data/mpfb2" bodies/
    for case in '{"a": ' '[]' '{"Hips": 3}' '{}'; do
        rig=$(find bodies/mpfb2 -name 'rig.cmu_mb.json'); printf '%s' "$case" >"$rig"
        refused "rig JSON: $case" 'rig.cmu_mb.json' "$program" import body bodies -o keep/bust.h5
    done
else echo "skip rig JSON (no data)"; fi

# ---- places that cannot be written
refused "output folder that is missing" 'keep/none/x.h5: cannot be written' "$program" make bust -o keep/none/x.h5
refused "output that is a folder" 'is a folder' "$program" make bust -o keep
refused "run folder that is a file" 'is a file|cannot be made' "$program" train tiny.yaml -o keep/bust.h5
refused "run folder that cannot be made" 'cannot be made|cannot be written' "$program" train tiny.yaml -o /proc/hairgrad/run
mkdir closed closed/run && chmod 555 closed/run closed
chmod 755 "$work" && chmod a+r tiny.yaml
if [ "$(id -u)" != 0 ]; then user=""
elif command -v setpriv >/dev/null 2>&1 && setpriv --reuid=65534 --regid=65534 --clear-groups test -x "$program" -a -r "$build/libhairgrad.so" 2>/dev/null; then user="setpriv --reuid=65534 --regid=65534 --clear-groups"
else user=none; fi
if [ "$user" != none ]; then # nothing is closed to root: another user tries
    # shellcheck disable=SC2086
    { refused "folder that may not be made" 'closed.*Permission denied' $user "$program" train tiny.yaml -o closed/other
    refused "folder that may not be written" 'closed/run: the folder cannot be written \(Permission denied\)' $user "$program" train tiny.yaml -o closed/run
    refused "file that may not be written" 'closed/x.h5: cannot be written \(Permission denied\)' $user "$program" make bust -o closed/x.h5; }
else echo "skip folder that may not be written (root, and no other user may run the program)"; fi

# ---- a full disk during a checkpoint: the last one stays, and the run can go on
"$program" train tiny.yaml -o keep/run --set training.steps=4 >/dev/null 2>&1 || { echo "not ok a short run"; failed=1; }
full() { (ulimit -S -f 8; exec "$program" train tiny.yaml -o keep/run --again); }
before=$(cksum <keep/run/checkpoint.h5)
"$program" make groom --body keep/bust.h5 --strands 4000 -o keep/large.h5 >/dev/null 2>&1
refused "full disk" 'large.h5: cannot be written \(File too large\)|large.h5: cannot be written \(No space' sh -c "ulimit -S -f 8; exec '$program' make groom --body keep/bust.h5 --strands 4000 -o keep/large.h5"
full >stdout 2>stderr; status=$?
if [ "$status" = 0 ] || [ "$status" -ge 126 ] || ! grep -q 'cannot be written (File too large)' stderr; then wrong "full disk during a checkpoint" "status $status"; else ok "full disk during a checkpoint"; fi
[ -n "$(find keep -name '*.part-*')" ] && { wrong "full disk leaves nothing over" "$(find keep -name '*.part-*')"; }

# ---- a run that is killed goes on to the same bits
"$program" train tiny.yaml -o whole >/dev/null 2>&1 || { echo "not ok whole run"; failed=1; }
"$program" train tiny.yaml -o cut --set training.steps=40 >/dev/null 2>&1 &
pid=$!
tries=0
while [ ! -f cut/checkpoint.h5 ] && [ $tries -lt 1000 ] && kill -0 $pid 2>/dev/null; do sleep 0.05; tries=$((tries + 1)); done
kill -9 $pid 2>/dev/null; wait $pid 2>/dev/null
"$program" train tiny.yaml -o cut --resume >stdout 2>stderr || wrong "resume after kill -9" "it failed"
for run in whole cut; do
    "$program" export $run --to h5 -o $run.h5 >/dev/null 2>&1
    sed -E 's/"(seconds|steps_per_second|time|rate)": [^,}]*//g' $run/log.jsonl | grep '"step": 40, "[lv]' | sort -u >$run.log
done
if [ -s whole.log ] && cmp whole.h5 cut.h5 >stderr 2>&1 && cmp whole.log cut.log >>stderr 2>&1; then ok "a killed run goes on to the same bits"
else cat whole.log cut.log >>stderr; wrong "a killed run goes on to the same bits" "the runs differ"; fi
refused "run folder that holds a run" 'resume|again' "$program" train tiny.yaml -o whole
refused "drape with a motion of other joints" 'other_joints.h5: .*missing .*extra Tail' "$program" drape whole --motion bad/other_joints.h5 -o keep/drape.vtkhdf
printf 'nonsense' >cut/checkpoint.h5; rm -f cut/best.h5
refused "damaged checkpoint" 'checkpoint.h5: ' "$program" train tiny.yaml -o cut --resume
refused "damaged run" 'checkpoint.h5: ' "$program" evaluate cut
refused "resume on another config" 'config|recipe' "$program" train tiny.yaml -o whole --resume --set losses.stretch.stiffness=3
exit $failed
