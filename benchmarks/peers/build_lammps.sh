#!/bin/sh
# Builds LAMMPS for this processor from Debian's source package (trixie), in six and a half minutes:
#   benchmarks/peers/build_lammps.sh && python benchmarks/peers/run.py --lammps native
# It needs a deb-src line, CMake and g++.
set -e
apt-get update && apt-get source --download-only lammps && tar xJf lammps_*.orig.tar.xz
cmake -S lammps-*/cmake -B build -D CMAKE_BUILD_TYPE=Release \
    -D CMAKE_CXX_FLAGS_RELEASE="-O3 -march=native -ffast-math -DNDEBUG" -D BUILD_SHARED_LIBS=ON \
    -D BUILD_MPI=OFF -D CMAKE_DISABLE_FIND_PACKAGE_MPI=ON -D PKG_GRANULAR=ON -D PKG_BPM=ON -D PKG_OPENMP=ON
make -C build lammps
mkdir -p native && cp -r lammps-*/python/lammps native && cp build/liblammps.so.0 native/lammps/liblammps.so
