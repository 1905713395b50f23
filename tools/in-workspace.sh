#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Runs a command in the environment of the built workspace: bash tools/in-workspace.sh COMMAND [ARGUMENT...]
set -e

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

# In a function, because the setup files would read this script's arguments as theirs.
load_workspace() {
  if [ ! -f "$root/build/ws/devel/setup.bash" ]; then
    echo "the workspace is not built yet: run 'make build'" >&2
    exit 1
  fi
  . "$root/build/ws/devel/setup.bash"
}

# ROS's Python is the system's, whichever other one comes first.
export PATH="/usr/bin:$PATH"
load_workspace

# Tests start hundreds of processes: none is to compile again what another one, or the distribution, has compiled.
unset PYTHONDONTWRITEBYTECODE
# Nor to start threads for the linear algebra that numpy is imported with and no test uses.
export OPENBLAS_NUM_THREADS=1
exec "$@"
