#!/bin/sh
# What the parts of a training are good for: the same recipe with one thing changed at a time, every network judged on the same
# held-out clips and body shapes, on the same strands, by the SAME energies: those of the recipe as it stands.
#
#   bench/ablation.sh [BUILD [STEPS ["SEEDS" [VARIANT...]]]]      default: build 1500 "1", all variants
#
# Runs are kept in OUT (out/ablation) and are not trained again; one that was broken off goes on. The table is in OUT/table.txt.
# From the environment (in brackets what fits the Sintel groom of neuralocks.yaml, whose edges are 4 mm and not 12):
#
#   RECIPE   examples/recipes/demo.yaml        SET      more for every run, like "scene.folder=out/demo/scene training.strands=400"
#   SHEAR    1.4e-7 J   [2.3e-8]               EDGE     0.012 m [0.004]: mean length of an edge, for the stiffness of free rods
#   GHOST    5e-7 N/m   [5e-6]                 RADIUS   0.006 m [0.0045], H 0.005 m [0.004]: reach of adhesion, of self collision
#   FRAMES   150 of each clip                  TILT     nod: the clip on which `hang` is measured; none: the held-out ones
#
# SHEAR and GHOST are such that the minimum hangs as far as that of bend_twist with 1e-8 N m^2 (docs/variants.md). Columns: time of a
# step; energy, and its part without gravity and body ("own": bending, stretch, inertia, drag: rare deep contacts weigh most
# in the sum and differ from seed to seed); gap (E - E_best) / (E_posed - E_best), E_best the lowest of the table; error of
# lengths; vertices inside; curl: bends between segments against those of the style; hang: how far tips are from the posed groom's,
# in % of the strands' length, where the head tilts: what stiff hair does not; speed of the tips.
set -eu
build=${1:-build} steps=${2:-1500} seeds=${3:-1}
[ $# -gt 3 ] && shift 3 || set --
source=$(cd "$(dirname "$0")/.." && pwd)
program=$build/hairgrad
out=${OUT:-out/ablation} recipe=${RECIPE:-$source/examples/recipes/demo.yaml} frames=${FRAMES:-150} tilt=${TILT:-nod}

product() { awk -v a="$1" -v b="$2" 'BEGIN { printf "%.3g", a * b }'; }
without() { for e in "$@"; do printf ' losses.%s.weight=0' "$e"; done; }
with() { # ENERGY KEY=VALUE...
    energy=$1; shift
    printf ' losses.%s.weight=1' "$energy"
    for s in "$@"; do printf ' losses.%s.%s' "$energy" "$s"; done
}
springs="$(without bend_twist stretch) $(with spring_edge stiffness=2) $(with spring_bend stiffness=5) $(with spring_torsion stiffness=5)"
edge=${EDGE:-0.012}
pull=$(product 0.2 "$(product "$edge" "$edge")") # 0.2 N/m over an edge
all="base locks_off chained smooth chained_smooth shear style adhesion_1e-7 adhesion_1e-6 adhesion_1e-5 self_collision springs springs_to_ghosts rods runs pose_reg"

settings() { # of a variant
    case $1 in
    base) ;;
    locks_off) echo features.locks=false ;;
    chained) echo "$(without bend_twist) $(with bend_twist_chain stiffness=1e-8)" ;;
    smooth) echo losses.bend_twist.strain=smooth ;;
    chained_smooth) echo "$(without bend_twist) $(with bend_twist_chain stiffness=1e-8 strain=smooth)" ;;
    shear) echo "$(without bend_twist) $(with shear stiffness="${SHEAR:-1.4e-7}")" ;;
    style) with hair_style stiffness=0.005 s_max=0.008 surface=scalp ;;
    adhesion_*) with adhesion stiffness="${1#adhesion_}" radius="${RADIUS:-0.006}" ;;
    self_collision) with self_collision stiffness=1e-10 h="${H:-0.005}" ;;
    springs) echo "$springs" ;;
    springs_to_ghosts) echo "$springs $(with integrity stiffness="${GHOST:-5e-7}")" ;;
    rods) echo "model.orientation_of=edges $(without bend_twist stretch) $(with cosserat_stretch_shear stiffness="$pull")" \
        "$(with cosserat_bend_twist stiffness="$(product 1e-8 "$edge")") $(with unit_quaternion stiffness="$(product 20 "$pull")")" ;;
    runs) echo training.frames=4 training.consecutive=4 ;;
    pose_reg) echo training.frames=4 training.consecutive=4 "$(with pose_reg stiffness=1e-5)" ;;
    *) echo "ablation.sh: there is no variant $1; there are: $all" >&2; exit 1 ;;
    esac
}

# The losses of a run's config, as KEY=VALUE.
losses() {
    awk '/^[a-z]/ { inside = $0 ~ /^losses:/; next }
        inside { match($0, /^ */); depth = RLENGTH / 2; key = $1; sub(/:$/, "", key); part[depth] = key; value = $0; sub(/^ *[^ ]*: ?/, "", value)
            if (value != "" && key != "learn") { name = "losses"; for (i = 1; i <= depth; i++) name = name "." part[i]; sub(/ .*/, "", value); print name "=" value } }' "$1/config.yaml"
}
# The value of a number in the mean of a metrics file.
value() { sed -n '/"mean"/,$p' "$1" | sed -n "s/.*\"$2\": \([-0-9.e+a-z]*\).*/\1/p" | sed 's/null/nan/' | head -n 1; }

train() { # VARIANT SEED RUN
    [ -f "$3/report.json" ] && return 0
    sets=$(settings "$1") || exit 1
    set -- "$1" "$2" "$3" --set training.steps="$steps" --set training.validate_every=0 --set training.checkpoint_every=500
    for s in ${SET:-} $sets; do set -- "$@" --set "$s"; done
    run=$3 seed=$2; shift 3
    [ -f "$run/checkpoint.h5" ] && set -- "$@" --resume
    "$program" train "$recipe" -o "$run" --set training.seed="$seed" "$@" >"$run.log" 2>&1 || { cat "$run.log" >&2; exit 1; }
}

judge() { # RUN JSON OPTION...: by the losses of the first seed's base
    run=$1 json=$2; shift 2
    losses "$base" >"$out/judge"
    for key in $(losses "$run" | sed -n 's/\.weight=.*/.weight/p'); do grep -q "^$key=" "$out/judge" || set -- "$@" --set "$key=0"; done
    while read -r s; do set -- "$@" --set "$s"; done <"$out/judge"
    "$program" evaluate "$run" --frames "$frames" --json "$json" --set training.seed=1 "$@" >"$run.table" 2>&1
}

for variant in "$@"; do settings "$variant" >/dev/null || exit 1; done
mkdir -p "$out"
: >"$out/rows.new"
first=${seeds%% *}
base=$out/base-$first-$steps
train base "$first" "$base"
for variant in ${*:-$all}; do
    for seed in $seeds; do
        run=$out/$variant-$seed-$steps
        train "$variant" "$seed" "$run"
        judge "$run" "$run.json" || { cat "$run.table" >&2; exit 1; }
        hang=$(value "$run.json" tip_moved_percent_of_length)
        if [ "$tilt" != none ] && judge "$run" "$run.tilt.json" --clip "$tilt"; then hang=$(value "$run.tilt.json" tip_moved_percent_of_length); fi
        seconds=$(sed -n 's/.*"training_seconds": \([0-9.e+-]*\).*/\1/p' "$run/report.json")
        echo "$variant $seed $seconds $(value "$run.json" energy_joule_per_strand) $(value "$run.json" energy_posed_joule_per_strand)" \
            "$(value "$run.json" gravity_body_joule_per_strand) $(value "$run.json" length_error_percent) $(value "$run.json" inside_percent)" \
            "$(value "$run.json" curl_of_rest) $hang $(value "$run.json" tip_speed_metres_per_second)" >>"$out/rows.new"
        tail -n 1 "$out/rows.new" >&2
    done
done
mv "$out/rows.new" "$out/rows"

awk -v steps="$steps" '
    { row[NR] = $0; if (NR == 1 || $4 < best) best = $4; posed = $5 }
    END {
        printf "%-18s %4s %8s %11s %9s %7s %8s %8s %7s %7s %8s\n", "variant", "seed", "ms/step", "energy nJ", "own nJ", "gap", "length %", "inside %", "curl", "hang %", "tip m/s"
        for (i = 1; i <= NR; i++) {
            split(row[i], f, " "); own = f[4] - f[6]
            printf "%-18s %4s %8.2f %11.2f %9.3f %7.3f %8.4f %8.3f %7.3f %7.2f %8.3f\n", f[1], f[2], 1000 * f[3] / steps, 1e9 * f[4], 1e9 * own, ((posed > best) ? (f[4] - best) / (posed - best) : 0), f[7], f[8], f[9], f[10], f[11]
            if (!n[f[1]]++) { order[++keys] = f[1]; low[f[1]] = high[f[1]] = own }
            sum[f[1]] += own; if (own < low[f[1]]) low[f[1]] = own; if (own > high[f[1]]) high[f[1]] = own
        }
        printf "posed groom: %.3f nJ a strand\n", 1e9 * posed
        for (i = 1; i <= keys; i++) if (n[order[i]] > 1) printf "%-18s own energy: mean %.3f nJ, seeds differ by %.3f nJ\n", order[i], 1e9 * sum[order[i]] / n[order[i]], 1e9 * (high[order[i]] - low[order[i]])
    }' "$out/rows" | tee "$out/table.txt"
