#!/bin/sh
# hairgrad profile: a table and JSON with the parts of a step, whose shares add up to it; wrong input is refused.
set -eu
build=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() { echo "test_profile: $*" >&2; exit 1; }

small="--set scene.strands=80 --set training.strands=40 --set scene.seconds=1 --set features.encoder_steps=5 --set model.width=16"
# shellcheck disable=SC2086
"$build/hairgrad" profile "$HG_SOURCE/examples/recipes/demo.yaml" $small --steps 5 --json "$folder/p.json" >"$folder/p.txt" 2>"$folder/p.err" ||
    { cat "$folder/p.err"; fail "it failed"; }
for word in "closest triangles" refit body_collision linear adam "gradient norm" roots "a step takes"; do
    grep -q "$word" "$folder/p.txt" || fail "the table lacks \"$word\""
done
python3 - "$folder/p.json" <<'END' || fail "the JSON is wrong"
import json, sys
p = json.load(open(sys.argv[1]))
assert p["step_seconds"] > 0 and p["steps"] == 5 and p["copy_bytes_per_second"] > 0
rows = {(r["group"], r["name"]): r for r in p["rows"]}
for key in [("forward", "physics"), ("backward", "physics"), ("body", "refit"), ("optimiser", "adam"), ("step", "sample")]:
    assert rows[key]["calls"] >= 1, key
shares = sum(r["share"] for r in p["rows"])
assert 0.5 < shares < 1.5, shares
END
if "$build/hairgrad" profile "$HG_SOURCE/examples/recipes/demo.yaml" --steps 0 2>"$folder/e"; then fail "0 steps were taken"; fi
grep -q "between 1" "$folder/e" || fail "0 steps: no clear sentence"
if "$build/hairgrad" profile "$folder/none.yaml" 2>"$folder/e"; then fail "a missing recipe was taken"; fi
echo "profile: good"
