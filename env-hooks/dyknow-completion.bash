# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Completion of `dyknow` and `rosrun dyknow dyknow` in bash, by argcomplete. Source it; the setup.bash
# of a catkin workspace that has DyKnow in it does.

_dyknow_rosrun() {
  local line="${COMP_LINE:0:COMP_POINT}"
  if [[ "$line" =~ ^[[:space:]]*rosrun[[:space:]]+dyknow[[:space:]]+(dyknow[[:space:]].*)$ ]]; then
    local COMP_LINE="${BASH_REMATCH[1]}"
    local COMP_POINT=${#COMP_LINE}
    _python_argcomplete dyknow
    return
  fi
  if ! declare -F _roscomplete_exe >/dev/null && declare -F _completion_loader >/dev/null; then
    # Where rosbash is loaded on demand, our own entry has kept it from being loaded.
    _completion_loader rosrun
    complete -F _dyknow_rosrun rosrun
  fi
  if declare -F _roscomplete_exe >/dev/null; then
    _roscomplete_exe "$@"
  fi
}

# Ubuntu 20.04 calls the program register-python-argcomplete3.
for _dyknow_register in register-python-argcomplete register-python-argcomplete3; do
  if command -v "$_dyknow_register" >/dev/null; then
    eval "$("$_dyknow_register" --no-defaults dyknow)"
    complete -F _dyknow_rosrun rosrun
    break
  fi
done
unset _dyknow_register
