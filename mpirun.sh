#!/usr/bin/env bash
# Computes a campaign on all cores under MPI; installs calcidem into .venv first if it is not there.
# Usage: ./mpirun.sh [-n RANKS] [--restarts K] [CONFIG] [options of 'calcidem run']
#   RANKS   one for every core (or task of the Slurm job) and one that coordinates, by default; 1 runs without MPI
#   K       starts again up to K times if ranks die and the others cannot go on; 3 by default
#   CONFIG  examples/quick.toml by default
# The exit code is that of calcidem: 0 complete, 75 stopped (the same command continues), 2 bad input, 1 anything else.
# MPIRUN names another launcher than the one that is installed with calcidem.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

ranks=0 # calcidem counts the cores
restarts=()
while true; do
  case "${1:-}" in
  -n) ranks=${2:?"-n needs the number of ranks"} ;;
  --restarts) restarts=(--restarts "${2:?"--restarts needs a number"}") ;;
  *) break ;;
  esac
  shift 2
done
if [ $# -eq 0 ] || [ "${1#-}" != "$1" ]; then
  set -- "$here/examples/quick.toml" "$@"
fi

. "$here/scripts/bootstrap.sh"
bootstrap openmpi
exec calcidem run "$@" --ranks "$ranks" ${restarts[@]+"${restarts[@]}"} --report
