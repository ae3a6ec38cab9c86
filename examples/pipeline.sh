#!/usr/bin/env bash
# The whole way of a controller: train a small one, evaluate it, compare it, draw one of its chases.
#
#     examples/pipeline.sh [FOLDER]
#
# takes some ten minutes on two cores and leaves everything in FOLDER (default: pipeline-output). Each step is one
# command that goes on where it was if it is interrupted, or can be run by itself; for more of each see its --help.
# SWARMCHASE, UPDATES, EPISODES and SETTING may be given from outside: the test of this file makes it tiny.
set -euo pipefail

folder=${1:-pipeline-output}
here=$(command -v "$(dirname "$0")/../.venv/bin/swarmchase" || true)  # what make chase installed, if it did
swarmchase=${SWARMCHASE:-${here:-swarmchase}}
updates=${UPDATES:-300}
episodes=${EPISODES:-500}
# F and rho: how often they listen, how alike they fade.
read -r -a setting <<<"${SETTING:---sampling-hz 10 --spatial-correlation 0.9}"

echo "== 1. train: the paper's networks by counterfactual regression, the method that learns fastest"
resume=()
[ -f "$folder/run/resume.safetensors" ] && resume=(--resume)
$swarmchase train batched --preset counterfactual "${setting[@]}" --folder "$folder/run" \
  --updates "$updates" --evaluation-interval "$updates" --evaluation-chases 100 "${resume[@]}"
weights="$folder/run/best.safetensors"  # the networks of the best evaluation, with the settings that made them

echo "== 2. evaluate: its movements in $episodes chases it has never seen, one row a chase in a Parquet table"
$swarmchase evaluate --controller "$weights" "${setting[@]}" --episodes "$episodes" --table "$folder/chases.parquet" --overwrite

echo "== 3. compare: on the same chases beside the gradient climber and the oracle, which knows the target"
$swarmchase compare --controllers "$weights" gradient oracle "${setting[@]}" --episodes "$episodes" \
  --folder "$folder/comparison"

echo "== 4. draw: one of its chases, and what was heard in it"
$swarmchase chase --controller "$weights" "${setting[@]}" --seed 7 --folder "$folder/chase"

echo "== done. Look at $folder/chase/chase.png, $folder/comparison/comparison.md and the figures beside it."
