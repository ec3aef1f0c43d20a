#!/bin/sh
# What the form of the bending energy does to a training: `strain: published` and `smooth`, direct and chained transport, with
# two seeds each so that a difference can be told from luck. Every network is judged on the same held-out clips and body
# shapes, on the same strands, by the SAME energies (bend_twist, published strain), whatever it was trained with.
#
#   bench/ablation.sh [BUILD] [STEPS] [SEEDS]        about 8 minutes on two quiet cores with 1,500 steps
#
# Rare deep contacts weigh most in the energy and differ from seed to seed; "own" is the energy without gravity and body: bending,
# stretch, inertia and drag.
#
# gap: (E - E_best) / (E_posed - E_best), E_best the lowest energy of the table: 0 is the best network, 1 the posed groom.
set -eu
build=${1:-build} steps=${2:-1500} seeds=${3:-"1 2"}
source=$(cd "$(dirname "$0")/.." && pwd)
program=$build/hairgrad
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

stiffness=1e-8
judge="--set training.seed=1 --set losses.bend_twist.weight=1 --set losses.bend_twist.stiffness=$stiffness --set losses.bend_twist.strain=published"
# The value of a number in the mean of a metrics file.
value() { sed -n '/"mean"/,$p' "$1" | sed -n "s/.*\"$2\": \([-0-9.e+]*\).*/\1/p" | head -n 1; }

for variant in "direct published" "direct smooth" "chained published" "chained smooth"; do
    set -- $variant
    if [ "$1" = direct ]; then
        energy="--set losses.bend_twist.strain=$2" other=
    else
        energy="--set losses.bend_twist.weight=0 --set losses.bend_twist_chain.weight=1 --set losses.bend_twist_chain.stiffness=$stiffness --set losses.bend_twist_chain.strain=$2"
        other="--set losses.bend_twist_chain.weight=0"
    fi
    for seed in $seeds; do
        run=$work/$1-$2-$seed
        # shellcheck disable=SC2086
        "$program" train "$source/examples/recipes/demo.yaml" -o "$run" --set training.steps="$steps" --set training.seed="$seed" \
            --set training.validate_every=0 --set training.checkpoint_every=0 $energy >"$run.log" 2>&1 || { cat "$run.log" >&2; exit 1; }
        # shellcheck disable=SC2086
        "$program" evaluate "$run" --frames 150 --json "$run.json" $judge $other >"$run.table" 2>&1 || { cat "$run.table" >&2; exit 1; }
        seconds=$(sed -n 's/.*"training_seconds": \([0-9.e+-]*\).*/\1/p' "$run/report.json")
        echo "$1 $2 $seed $seconds $(value "$run.json" energy_joule_per_strand) $(value "$run.json" energy_posed_joule_per_strand)" \
            "$(value "$run.json" length_error_percent) $(value "$run.json" inside_percent)" \
            "$(value "$run.json" tip_speed_metres_per_second) $(value "$run.json" gravity_body_joule_per_strand)" >>"$work/rows"
        tail -n 1 "$work/rows" >&2
    done
done

awk -v steps="$steps" '
    { row[NR] = $0; if (NR == 1 || $5 < best) best = $5; posed = $6 }
    END {
        printf "%-8s %-10s %5s %10s %14s %10s %8s %9s %9s %9s\n", "frame", "strain", "seed", "ms a step", "energy nJ", "own nJ", "gap", "length %", "inside %", "tip m/s"
        for (i = 1; i <= NR; i++) {
            split(row[i], f, " ")
            printf "%-8s %-10s %5s %10.2f %14.3f %10.3f %8.4f %9.4f %9.3f %9.3f\n", f[1], f[2], f[3], 1000 * f[4] / steps, 1e9 * f[5], 1e9 * (f[5] - f[10]), ((posed > best) ? (f[5] - best) / (posed - best) : 0), f[7], f[8], f[9]
            own = f[5] - f[10]; key = f[1] " " f[2]; n[key]++; sum[key] += own; if (n[key] == 1) order[++keys] = key
            if (n[key] == 1) low[key] = high[key] = own
            if (own < low[key]) low[key] = own
            if (own > high[key]) high[key] = own
        }
        printf "posed groom: %.3f nJ a strand\n\n", 1e9 * posed
        for (i = 1; i <= keys; i++) printf "%-20s own energy: mean %.3f nJ, seeds differ by %.3f nJ\n", order[i], 1e9 * sum[order[i]] / n[order[i]], 1e9 * (high[order[i]] - low[order[i]])
    }' "$work/rows"
