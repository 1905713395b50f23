# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Memory of one process that other processes of the same user read: an anonymous file.

The owner of an ``Arena`` writes messages into regions of the file; an ``ArenaReader`` in another
process copies them from there. The memory of a region is reserved before it is written, and the
file never shrinks: a lack of memory is an error, and no access ends a process. The kernel frees
the file with the last process that has it open, so ``kill -9`` leaves nothing behind.

The file is handed out, open for reading only, over an abstract unix socket. That has no file
either, cannot be reached from another host or network namespace, and says which user is at the
other end.
"""

from __future__ import annotations

import array
import collections
import contextlib
import fcntl
import functools
import itertools
import logging
import mmap
import os
import select
import socket
import struct
import time
import uuid
from typing import Callable, Sequence

from dyknow.errors import HostError
from dyknow.locks import state_lock
from dyknow.periodic import in_background
from dyknow.ros.process.descriptors import PatientSocket

#: Bytes of free regions that are kept for the next messages; the memory of further ones is freed.
IDLE = 64 << 20
#: Seconds for which regions stay that were sent over a connection which has ended since.
LINGER = 10.0
#: Seconds that the other side may take to hand out its file.
_PATIENCE = 10.0
_LEAST = 64 << 20  # bytes of the file, of which only regions take memory
#: Precedes the content of a region: its number, of which no other one has the same.
_NUMBER = struct.Struct("<Q")
_CREDENTIALS = struct.Struct("3i")  # of a peer: process, user, group

_log = logging.getLogger("rosout.dyknow")


class ArenaRegion:
    """Where a message is in an arena, until the last reference to this object goes.

    Attributes:
        offset: in the file, in bytes.
        number: which the file has there while the region is used for this message.
        size: of the message, in bytes.
    """

    __slots__ = ("_arena", "_room", "number", "offset", "size")

    def __init__(self, arena: Arena, offset: int, room: int, number: int, size: int) -> None:
        self._arena = arena
        self._room = room
        self.offset = offset
        self.number = number
        self.size = size

    def __del__(self) -> None:
        self._arena.take_back(self.offset, self._room)


class Arena:
    """The file of this process; ``OSError`` where the system has no such files.

    Attributes:
        address: of the socket that hands it out.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        with contextlib.ExitStack() as opened:
            self._open(opened)
            opened.pop_all()

    def _open(self, opened: contextlib.ExitStack) -> None:
        """Make the file, and start to hand it out; ``opened`` is closed if that fails."""
        self._file = os.memfd_create("dyknow", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        opened.callback(os.close, self._file)
        fcntl.fcntl(self._file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_SEAL)
        self._process = os.getpid()
        self._lock = state_lock("arena")
        self._numbers = itertools.count(int.from_bytes(os.urandom(6), "little") << 15)
        self._end = 0
        os.ftruncate(self._file, _LEAST)  # which takes no memory
        self._pages = opened.enter_context(mmap.mmap(self._file, _LEAST))
        #: Free regions, by their size: those that hold memory, and those that do not.
        self._warm: dict[int, list[int]] = {}
        self._cold: dict[int, list[int]] = {}
        self._idle = 0
        self._returned: collections.deque[tuple[int, int]] = collections.deque()
        self._lingering: collections.deque[tuple[float, Sequence[ArenaRegion]]] = (
            collections.deque()
        )
        self.address = f"dyknow-{uuid.uuid4().hex}"
        self._socket = opened.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        self._socket.bind("\0" + self.address)
        self._socket.listen(64)
        read_only = os.open(f"/proc/self/fd/{self._file}", os.O_RDONLY | os.O_CLOEXEC)
        opened.callback(os.close, read_only)
        hand_out = functools.partial(self._hand_out, read_only)
        in_background("handing out shared memory", hand_out)

    def write(self, content: bytes | bytearray) -> ArenaRegion | None:
        """Write a message; None if there is no memory for it."""
        if os.getpid() != self._process:  # a child that was forked: the regions are its parent's
            return None
        size = len(content)
        room = _room(size + _NUMBER.size)
        try:
            offset = self._allot(room)
        except OSError as error:
            _log.debug("no shared memory for a message of %d bytes: %s", size, error)
            return None
        region = ArenaRegion(self, offset, room, next(self._numbers), size)
        pages, at = self._pages, offset + _NUMBER.size
        # The number first: a reader of the region's last message has to see that it is gone.
        pages[offset:at] = _NUMBER.pack(region.number)
        pages[at : at + size] = content
        return region

    def take_back(self, offset: int, room: int) -> None:
        """Note that a region is free, on any thread; the next ``write`` may use it."""
        self._returned.append((offset, room))

    def linger(self, regions: Sequence[ArenaRegion]) -> None:
        """Keep regions for a while: a subscriber may be about to read them, and cannot say so."""
        if regions:
            self._lingering.append((self._clock(), regions))

    def _allot(self, room: int) -> int:
        self._sort_returned()
        with self._lock:
            if self._warm.get(room):
                self._idle -= room
                return self._warm[room].pop()
            if self._cold.get(room):
                offset = self._cold[room].pop()
            else:
                offset, end = self._end, self._end + room
                if end > len(self._pages):
                    size = 1 << end.bit_length()
                    os.ftruncate(self._file, size)
                    self._pages = mmap.mmap(self._file, size)
                self._end = end
        try:
            os.posix_fallocate(self._file, offset, room)
        except OSError:
            with self._lock:
                self._cold.setdefault(room, []).append(offset)
            raise
        return offset

    def _sort_returned(self) -> None:
        with self._lock:
            while self._lingering and self._lingering[0][0] + LINGER < self._clock():
                self._lingering.popleft()
            returned = [self._returned.popleft() for _ in range(len(self._returned))]
        for offset, room in returned:
            is_surplus = self._idle + room > IDLE
            if is_surplus:  # first: as soon as it is in the table it may be written again
                self._pages.madvise(mmap.MADV_REMOVE, offset, room)
            with self._lock:
                (self._cold if is_surplus else self._warm).setdefault(room, []).append(offset)
                self._idle += 0 if is_surplus else room

    def _hand_out(self, read_only: int) -> None:
        message = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [read_only]))]
        listener, poll = PatientSocket(self._socket), select.poll()
        poll.register(self._socket, select.POLLIN)
        while True:
            poll.poll()  # an accept that waits has taken a descriptor, which no list of them shows
            try:
                peer, _ = listener.accept()
                with peer:
                    if _user(peer) == os.geteuid():
                        peer.settimeout(_PATIENCE)
                        peer.sendmsg([b"1"], message)
            except OSError as error:
                _log.debug("a peer did not take the shared memory: %s", error)


class ArenaReader:
    """Another process's file, open until this object goes.

    Raises:
        HostError: it cannot be had: from another host, namespace or user, or without a descriptor
            that is free.
    """

    def __init__(self, address: str) -> None:
        self._file = -1
        self._pages: mmap.mmap | None = None
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer:
                peer.settimeout(_PATIENCE)
                peer.connect("\0" + address)
                if _user(peer) != os.geteuid():
                    raise HostError("the shared memory is another user's")
                _, messages, _, _ = peer.recvmsg(1, socket.CMSG_SPACE(array.array("i").itemsize))
        except OSError as error:
            raise HostError(f"the shared memory is out of reach: {error}") from error
        for _, kind, data in messages:
            if kind == socket.SCM_RIGHTS:
                self._file = array.array("i", data)[0]
                os.set_inheritable(self._file, False)
        if self._file < 0:
            raise HostError("the shared memory was not handed out, or no descriptor is free")

    def read(self, offset: int, number: int, size: int) -> bytes | None:
        """Copy a message; None if its region is used for another one by now."""
        begin, pages = offset + _NUMBER.size, self._pages
        try:
            if pages is None or begin + size > len(pages):
                length = os.fstat(self._file).st_size
                self._pages = pages = mmap.mmap(self._file, length, prot=mmap.PROT_READ)
        except (OSError, ValueError):  # it takes a descriptor and address space
            data = os.pread(self._file, size, begin)
            found = os.pread(self._file, _NUMBER.size, offset)
        else:
            data, found = pages[begin : begin + size], pages[offset:begin]
        return data if found == _NUMBER.pack(number) and len(data) == size else None

    def __del__(self, close: Callable[[int], None] = os.close) -> None:
        if self._file >= 0:  # at the end of the interpreter the module may have no ``os`` any more
            close(self._file)


def _room(size: int) -> int:
    """Round up to pages, by an eighth at most, so that messages of similar sizes share regions."""
    step = max(mmap.PAGESIZE, 1 << max(0, size.bit_length() - 4))
    return -(-size // step) * step


def _user(peer: socket.socket) -> int:
    found = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return int(_CREDENTIALS.unpack(found)[1])
