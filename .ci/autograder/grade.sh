#!/usr/bin/env bash
# PrairieLearn runs this for each submission.
root=${GRADE:-/grade}
cd "$(dirname "$0")/course" || exit 1
mkdir -p "$root/results"
export PYTHONPATH=$PWD
exec .venv/bin/python -m tofrender grade @folder@ --submission "$root/student" --format prairielearn \
  -o "$root/results/results.json" --time-limit @time_limit_s@ --memory @memory_gib@
