#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Builds the checkout in a catkin workspace of its own, build/ws: bash tools/build.sh [NAME [TARGET or CMAKE ARGUMENT...]]
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
name=${1:-ws}
workspace="$root/build/$name"
package="$workspace/src/dyknow"

# The entries are linked one by one: a link to the whole checkout would contain itself, and rosrun's search follows links.
# What is linked stays so: tests may be running from here.
mkdir -p "$package"
find "$package" -mindepth 1 -maxdepth 1 -xtype l -delete
for entry in "$root"/*; do
  link="$package/${entry##*/}"
  [ "${entry##*/}" = build ] || [ "$link" -ef "$entry" ] || ln -sfn "$entry" "$link"
done

# ROS's Python is the system's, whichever other one comes first.
export PATH="/usr/bin:$PATH"
if [ -f /opt/ros/noetic/setup.bash ]; then
  set +u
  . /opt/ros/noetic/setup.bash
  set -u
fi
# Messages are generated for the languages that the package is written in.
export ROS_LANG_DISABLE=geneus:genlisp:gennodejs
# Without catkin_make's limit of the load: the checks that run beside the build would keep it to one core.
export ROS_PARALLEL_JOBS=${ROS_PARALLEL_JOBS:--j$(nproc)}
cd "$workspace"
log="$workspace/build.log"
if ! catkin_make -DPYTHON_EXECUTABLE=/usr/bin/python3 -DCMAKE_BUILD_TYPE=Release "${@:2}" >"$log" 2>&1; then
  cat "$log" >&2
  echo "build: failed" >&2
  exit 1
fi
echo "build: done, in build/$name (log: build/$name/build.log)"
