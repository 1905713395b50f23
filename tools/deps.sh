#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Installs the distribution's packages that DyKnow needs and that are not there yet.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)

. /etc/os-release
list="$here/packages/${ID:-unknown}-${VERSION_ID:-unknown}"
if [ ! -f "$list" ]; then
  echo "deps: ${PRETTY_NAME:-this system} is not one that 'make deps' knows ($(cd "$here/packages" && echo *))." >&2
  echo "deps: install what package.xml lists by hand, or with 'rosdep install', and build in your own catkin workspace." >&2
  exit 1
fi

mapfile -t wanted < <(sed -e 's/#.*//' -e '/^[[:space:]]*$/d' "$list")
present=$(dpkg-query --show --showformat '${db:Status-Status} ${Package}\n' "${wanted[@]}" 2>/dev/null | sed -n 's/^installed //p' || true)
missing=()
for package in "${wanted[@]}"; do
  grep -qxF -- "$package" <<<"$present" || missing+=("$package")
done

if [ ${#missing[@]} -eq 0 ]; then
  echo "deps: all ${#wanted[@]} packages are installed"
  exit 0
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
  if ! command -v sudo >/dev/null; then
    echo "deps: missing, and neither root nor sudo to install them: ${missing[*]}" >&2
    exit 1
  fi
  as_root=(sudo)
fi
apt=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300)
# Who is root from the start is in a container most often: no need to wait for the disk file by file.
[ ${#as_root[@]} -gt 0 ] || apt+=(-o Dpkg::Options::=--force-unsafe-io)

echo "deps: installing ${#missing[@]} of ${#wanted[@]} packages: ${missing[*]}"
"${apt[@]}" update -q
unknown=()
for package in "${missing[@]}"; do
  apt-cache show "$package" >/dev/null 2>&1 || unknown+=("$package")
done
if [ ${#unknown[@]} -gt 0 ]; then
  echo "deps: the package sources of this machine do not have: ${unknown[*]}" >&2
  [ "$ID" != ubuntu ] || echo "deps: set up the package source of ROS Noetic first." >&2
  exit 1
fi
"${apt[@]}" install -q -y --no-install-recommends "${missing[@]}"
echo "deps: installed ${missing[*]}"
