# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Runs commands that may not outlive their time limit, nor leave children of theirs behind.

Each command leads a process group of its own, which is ended by its id, and only while it is ours.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from pathlib import Path
from typing import Mapping, Sequence

END_TIMEOUT = 30.0  # s, for a command to end its children after SIGINT


def run_logged(
    argv: Sequence[str], log: Path, timeout: float, environment: Mapping[str, str]
) -> int:
    """Runs a command with its output in a file, and with variables besides those of this process.

    After the timeout (s) it is ended, and a line of the log says so.

    Returns:
        The exit code; that of timeout(1), 124, when it was ended.
    """
    with log.open("w") as output:
        try:
            process = subprocess.Popen(
                argv,
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            output.write(f"{error}\n")
            return 127
        try:
            return process.wait(timeout)
        except subprocess.TimeoutExpired:
            _end(process)
            output.seek(0, os.SEEK_END)
            output.write(f"\nended after {timeout:.0f} s\n")
            return 124
        finally:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a command that still runs: with SIGINT first, so that it can end what it started."""
    if process.poll() is not None:
        return
    process.send_signal(signal.SIGINT)
    try:
        process.wait(END_TIMEOUT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def own_network() -> tuple[str, ...]:
    """What to put before a command for a network of its own; () where none may be made.

    ROS masters end and notify nodes by their address. Commands that run at the same time and share
    a network do this to each other's nodes, whenever a port is used again soon enough. The network
    has the addresses that the name of this host stands for, and no way out. Servers that do not
    ask for a port get an odd one in the lower half of the range: it is wide, so that a node seldom
    gets the port of one that has ended, to which the master still sends what is meant for that.
    """
    try:
        infos = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        adds = "".join(
            f"ip address add {address} dev lo && "
            for address in sorted({str(info[4][0]) for info in infos})
            if not address.startswith("127.")
        )
        ports = "(echo 12000 65535 >/proc/sys/net/ipv4/ip_local_port_range) 2>/dev/null"
        script = f'ip link set lo up && {adds}{{ {ports}; exec "$@"; }}'
        prefix = ("unshare", "--net", "sh", "-c", script, "sh")
        subprocess.run([*prefix, "true"], capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ()
    return prefix
