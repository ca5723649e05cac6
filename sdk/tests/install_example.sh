#!/usr/bin/env bash
# Installs the SDK into an empty folder, builds the example against it by find_package, and denoises with it:
# install_example.sh BUILD_DIR SOURCE_DIR MODEL
set -euo pipefail
build=$1 source=$2 model=$3
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

cmake --install "$build" --prefix "$scratch/prefix" >"$scratch/log" || { cat "$scratch/log"; exit 1; }
cmake -S "$source/examples" -B "$scratch/build" -DCMAKE_PREFIX_PATH="$scratch/prefix" -DCMAKE_BUILD_TYPE=Release \
    >"$scratch/log" 2>&1 || { cat "$scratch/log"; exit 1; }
cmake --build "$scratch/build" >"$scratch/log" 2>&1 || { cat "$scratch/log"; exit 1; }
"$scratch/build/denoise_buffers" "$model" "$scratch/clean.ppm" >"$scratch/report"
grep -q '"tiles":' "$scratch/report"
[ "$(stat -c %s "$scratch/clean.ppm")" = $((15 + 320 * 240 * 3)) ]

# A model that is not there is an error that says what there is.
if "$scratch/build/denoise_buffers" no-such-model 2>"$scratch/error"; then exit 1; fi
grep -q 'no-such-model' "$scratch/error"
echo "installed, built and denoised"
