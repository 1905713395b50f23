# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Hosts on one machine, and a network between them that the test controls.

A host is a network namespace with an address of its own. Its only link is a TUN device whose other
end this process holds: a thread reads each packet and delivers it to its host, delayed if that
host is far away, or never if the link is cut. Packets are lost silently, as on a radio link: no
error reports an unreachable host. The namespace that the test itself runs in, with the master
of its suite, is one of the hosts, `network.desk`.

Nothing outlives the test, however it ends: a device is removed when this process closes its
descriptor, and a namespace when its last process ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import itertools
import os
import select
import shutil
import socket
import struct
import subprocess
import threading
import time
from typing import Iterator
from urllib.parse import urlsplit

from processes import Running

#: A range reserved for network tests (RFC 2544); each network takes one /24 of it.
_RANGE = "198.18"
_MTU = 9000
_QUEUE = 10000
_TUNSETIFF = 0x400454CA
#: A new device for IP packets, without an extra header.
_TUN = 0x0001 | 0x1000 | 0x8000
_DEVICE = "/dev/net/tun"
#: Address of a name server that never answers: no host has it.
_NOBODY = 250


def missing() -> str:
    """Why this machine cannot run such hosts; empty if it can."""
    if os.geteuid():
        return "root may make network namespaces, others may not"
    for program in ("ip", "nsenter", "unshare"):
        if shutil.which(program) is None:
            return f"there is no program '{program}'"
    if not os.access(_DEVICE, os.W_OK):
        return f"{_DEVICE} cannot be opened"
    with contextlib.suppress(subprocess.CalledProcessError):
        subprocess.run(["unshare", "--net", "--mount", "true"], check=True, capture_output=True)
        return ""
    return "namespaces cannot be made here"


class Host:
    """A network namespace with an address, in which processes run.

    Attributes:
        address: its IP address.
    """

    def __init__(self, network: Network, number: int) -> None:
        """Join a network; called by `Network`."""
        self.device, name = network.plug(number)
        self.address = f"{network.prefix}.{number}"
        self._network = network
        self._namespace = ""
        self._holder: subprocess.Popen[bytes] | None = None
        if number > 1:
            # A namespace lives as long as a process is in it; this one ends with our end of its
            # pipe.
            self._holder = subprocess.Popen(
                ["unshare", "--net", "sh", "-c", "echo in; cat"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            self._holder.stdout.readline()
            self._namespace = f"/proc/{self._holder.pid}/ns/net"
            _ip("link", "set", name, "netns", str(self._holder.pid))
            self._here("ip", "link", "set", "lo", "up")
        self._here("ip", "link", "set", name, "mtu", str(_MTU), "txqueuelen", str(_QUEUE), "up")
        self._here("ip", "address", "add", f"{self.address}/24", "dev", name)

    def command(self, *command: str, resolver: str = "") -> list[str]:
        """Wrap a command so that it runs on this host, in the same process.

        Args:
            command: program and arguments.
            resolver: file to be used in place of /etc/resolv.conf.
        """
        environment = [f"ROS_IP={self.address}", f"ROS_MASTER_URI={self._network.master}"]
        mounting = [] if not resolver else ["unshare", "--mount", "sh", "-c"]
        if resolver:
            mounting += ['mount --bind "$0" /etc/resolv.conf && exec "$@"', resolver]
        return [*self._entering(), "env", "-u", "ROS_HOSTNAME", *environment, *mounting, *command]

    def run(self, *command: str) -> Running:
        """Start a process on this host."""
        return Running(*self.command(*command))

    def is_heard(self) -> bool:
        """Whether everything that was sent from this host has arrived.

        The kernel sends lost packets again after pauses that double, even when the sender is dead:
            the master would take a late registration for a new node of that name.
        """
        table = subprocess.run(
            [*self._entering(), "cat", "/proc/net/tcp"], check=True, capture_output=True, text=True
        ).stdout
        return all(row.split()[4].startswith("00000000:") for row in table.splitlines()[1:])

    def silent_resolver(self, folder: str) -> str:
        """Write the configuration of a name server that does not answer; returns the file."""
        path = os.path.join(folder, "resolv.conf")
        with open(path, "w") as file:
            file.write(f"nameserver {self._network.prefix}.{_NOBODY}\n")
        return path

    def __enter__(self) -> Host:
        return self

    def __exit__(self, *unused: object) -> None:
        """Leave the network; the namespace ends with the last process in it."""
        self._network.remove(self)
        if self._holder is not None:
            self._holder.stdin.close()
            self._holder.stdout.close()
            self._holder.wait()

    def _entering(self) -> list[str]:
        return ["nsenter", f"--net={self._namespace}"] if self._namespace else []

    def _here(self, *command: str) -> None:
        subprocess.run([*self._entering(), *command], check=True)


class Network:
    """Hosts and the ways between them; safe from any thread.

    Attributes:
        prefix: of all addresses.
        desk: the host that the test itself runs on.
        master: URI of the ROS master on the desk, for every host.
    """

    def __init__(self, master_uri: str) -> None:
        """Make a network that has only the desk.

        Args:
            master_uri: the master of the suite, as this process knows it.
        """
        self.prefix = ""
        self._lock = threading.Lock()
        self._hosts: dict[bytes, Host] = {}
        self._cut: set[tuple[Host, Host]] = set()
        self._delays: dict[Host, float] = {}
        self._numbers = itertools.count(1)
        self._leaving: list[Host] = []
        self._waiting: list[tuple[float, int, Host, bytes]] = []
        self._order = itertools.count()
        self._wake, self._waker = os.pipe()
        self.desk = self.host()
        self.master = f"http://{self.desk.address}:{urlsplit(master_uri).port}"
        threading.Thread(target=self._carry, name="network", daemon=True).start()

    def host(self) -> Host:
        """Make another host."""
        host = Host(self, next(self._numbers))
        with self._lock:
            self._hosts[socket.inet_aton(host.address)] = host
        os.write(self._waker, b"!")
        return host

    def remove(self, host: Host) -> None:
        """Take a host off the network; its device is closed by the thread that reads it."""
        with self._lock:
            del self._hosts[socket.inet_aton(host.address)]
            self._leaving.append(host)
        os.write(self._waker, b"!")

    # Faults

    @contextlib.contextmanager
    def cut(self, *hosts: Host) -> Iterator[None]:
        """Lose every packet from and to these hosts."""
        with self._lock:
            others = set(self._hosts.values())
        ways = {way for host in hosts for other in others for way in _both(host, other)}
        with self.without(*ways):
            yield

    @contextlib.contextmanager
    def without(self, *ways: tuple[Host, Host]) -> Iterator[None]:
        """Lose every packet on these links, each from one host to another."""
        with self._lock:
            new = set(ways) - self._cut
            self._cut |= new
        try:
            yield
        finally:
            with self._lock:
                self._cut -= new

    @contextlib.contextmanager
    def far(self, host: Host, seconds: float) -> Iterator[None]:
        """Delay every packet from and to a host, in each direction."""
        with self._lock:
            self._delays[host] = seconds
        try:
            yield
        finally:
            with self._lock:
                del self._delays[host]

    # The switch

    def plug(self, number: int) -> tuple[int, str]:
        """Make the device of a host; returns our end of it and its name."""
        if self.prefix:
            subnet = self.prefix.rpartition(".")[2]
            return _tun(f"dk{subnet}-{number}"), f"dk{subnet}-{number}"
        for subnet in range(1, 255):  # the desk's device reserves the subnet
            with contextlib.suppress(OSError):
                device = _tun(f"dk{subnet}-{number}")
                self.prefix = f"{_RANGE}.{subnet}"
                return device, f"dk{subnet}-{number}"
        raise RuntimeError(f"every network of {_RANGE}.0.0/16 is in use")

    def _carry(self) -> None:
        while True:
            with self._lock:
                while self._leaving:
                    os.close(self._leaving.pop().device)
                senders = {host.device: host for host in self._hosts.values()}
                pause = self._waiting[0][0] - time.monotonic() if self._waiting else None
            patience = None if pause is None else max(0.0, pause)
            ready, _, _ = select.select([*senders, self._wake], [], [], patience)
            for device in ready:
                if device == self._wake:
                    os.read(device, 1)
                    continue
                self._take(senders[device], os.read(device, 65536))
            self._deliver()

    def _take(self, sender: Host, packet: bytes) -> None:
        if packet[0] >> 4 != 4:
            return
        with self._lock:
            receiver = self._hosts.get(packet[16:20])
            if receiver is None or (sender, receiver) in self._cut:
                return
            delay = self._delays.get(sender, 0.0) + self._delays.get(receiver, 0.0)
            due = time.monotonic() + delay
            heapq.heappush(self._waiting, (due, next(self._order), receiver, packet))

    def _deliver(self) -> None:
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            with self._lock:
                _, _, receiver, packet = heapq.heappop(self._waiting)
                is_here = receiver in self._hosts.values()
            if is_here:
                os.write(receiver.device, packet)


def _both(one: Host, other: Host) -> set[tuple[Host, Host]]:
    return {(one, other), (other, one)} if one is not other else set()


def _tun(name: str) -> int:
    device = os.open(_DEVICE, os.O_RDWR | os.O_CLOEXEC)
    try:
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _TUN))
    except OSError:
        os.close(device)
        raise
    return device


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)
