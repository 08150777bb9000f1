#!/usr/bin/env bash
# A campaign in parts with GNU parallel, then merged:  examples/gnu-parallel.sh CONFIG OUT.db [PARTS] [options of parallel]
#
#     examples/gnu-parallel.sh paper.toml paper.db 8                              # on this machine, a part for each core
#     examples/gnu-parallel.sh paper.toml paper.db 64 --sshloginfile hosts --workdir .   # on hosts that share this folder
#
# A part is one process with a database of its own. Given again, the same command goes on where it stopped.
set -euo pipefail
config=${1:?"give a configuration and the database to make: examples/gnu-parallel.sh CONFIG OUT.db"} out=${2:?}
parts=${3:-$(nproc)}
calcidem run "$config" --packing-only
parallel "${@:4}" --halt soon,fail=1 calcidem run "$config" --part "{}/$parts" --db "part-{}.db" ::: $(seq "$parts")
calcidem merge $(seq -f "part-%.0f.db" "$parts") --out "$out"
