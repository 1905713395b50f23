# Completion of `dyknow` and `rosrun dyknow dyknow` in bash. Source it; the setup.bash of a catkin
# workspace that has DyKnow in it does.

# Ask `dyknow complete` what the word at the cursor may become.
# Arguments: the command line up to the cursor, beginning with the program's name.
_dyknow_complete_line() {
  mapfile -t COMPREPLY < <(command dyknow complete -- "$1" 2>/dev/null)
  if [ "${#COMPREPLY[@]}" -eq 1 ]; then
    # More is to follow behind a nodelet's colon and behind a folder.
    case "${COMPREPLY[0]}" in
      *[:/]) compopt -o nospace 2>/dev/null ;;
    esac
  fi
}

_dyknow() {
  _dyknow_complete_line "${COMP_LINE:0:COMP_POINT}"
}

_dyknow_rosrun() {
  local line="${COMP_LINE:0:COMP_POINT}"
  if [[ "$line" =~ ^[[:space:]]*rosrun[[:space:]]+dyknow[[:space:]]+(dyknow[[:space:]].*)$ ]]; then
    _dyknow_complete_line "${BASH_REMATCH[1]}"
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

complete -F _dyknow dyknow
complete -F _dyknow_rosrun rosrun
