#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Makes a virtual environment under build/, once for each state of its requirements:
# bash tools/venv.sh NAME PYTHON REQUIREMENTS [OPTION...]
set -euo pipefail

name=$1 python=$2 requirements=$3
shift 3
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv="$root/build/$name"

cmp -s "$requirements" "$venv/installed-requirements.txt" && exit 0
echo "venv: making build/$name"
rm -rf "$venv"
mkdir -p "$root/build"
env -u PYTHONPATH "$python" -m venv "$@" "$venv"
env -u PYTHONPATH "$venv/bin/python" -m pip install -qq --disable-pip-version-check -r "$requirements"
cp "$requirements" "$venv/installed-requirements.txt"
