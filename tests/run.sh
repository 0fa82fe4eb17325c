#!/usr/bin/env bash
# Installs what is missing, builds everything, and runs every test. This is the project's whole test command.
#
# usage: bash tests/run.sh [CTEST_OPTION...]        e.g. bash tests/run.sh -R ColmapModel
#   BUILD_DIR=DIR   where to build (default: build/tests)
#   S2GS_CUDA=OFF   leave the CUDA backend out (default AUTO: built when a CUDA Toolkit is found)
#   S2GS_CUDA_ARCHITECTURES=LIST   GPUs to compile for (default: all that CMakeLists.txt names)
set -euo pipefail
cd "$(dirname "$0")/.."

bash .ci/install_packages build test

build_dir=${BUILD_DIR:-build/tests}
venv=tests/.venv
if ! cmp -s tests/interop/requirements.txt "$venv/requirements.txt"; then
  echo "Setting up the Python peers of the interoperability tests in $venv"
  rm -rf "$venv"
  /usr/bin/python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet --disable-pip-version-check -r tests/interop/requirements.txt
  cp tests/interop/requirements.txt "$venv/requirements.txt"
fi

cmake -S . -B "$build_dir" -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_UNITY_BUILD=ON \
  -DS2GS_CUDA="${S2GS_CUDA:-AUTO}" ${S2GS_CUDA_ARCHITECTURES:+-DS2GS_CUDA_ARCHITECTURES="$S2GS_CUDA_ARCHITECTURES"} \
  -DS2GS_TEST_PYTHON="$PWD/$venv/bin/python"
cmake --build "$build_dir"
ctest --test-dir "$build_dir" --output-on-failure --no-tests=error -j "$(nproc)" "$@"
