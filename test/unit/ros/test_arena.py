# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Memory that processes share: regions, their reuse, and who gets the file."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from dyknow.errors import HostError
from dyknow.ros.transport import arena as module
from dyknow.ros.transport.arena import Arena, ArenaReader

MB = 1 << 20


@pytest.fixture
def arena():
    return Arena()


def held_by(arena):
    """Bytes of memory that the file takes."""
    return os.fstat(arena._file).st_blocks * 512


def copy(reader, region):
    return reader.read(region.offset, region.number, region.size)


def run(code: str, *arguments: str, wrapper: tuple[str, ...] = ()) -> str:
    """Run code in a process of its own, which prints why its reader was refused, or nothing."""
    program = (
        "import os, resource, sys\n"
        "from dyknow.errors import HostError\n"
        "from dyknow.ros.transport.arena import Arena, ArenaReader\n"
        f"{code}\n"
    )
    command = (*wrapper, sys.executable, "-c", program, *arguments)
    return subprocess.run(
        command, check=True, text=True, timeout=120, stdout=subprocess.PIPE
    ).stdout


READ = """
try:
    ArenaReader(sys.argv[1])
except HostError as error:
    print(error)
"""


def test_a_reader_copies_what_was_written(arena):
    first = arena.write(b"abc" * MB)
    second = arena.write(bytearray(b"headbody"))
    reader = ArenaReader(arena.address)
    assert copy(reader, second) == b"headbody"
    assert copy(reader, first) == b"abc" * MB


def test_a_file_that_has_grown_is_mapped_again(arena):
    reader = ArenaReader(arena.address)
    regions = [arena.write(bytes([number]) * (9 * MB)) for number in range(20)]
    for number, region in enumerate(regions):
        assert copy(reader, region) == bytes([number]) * (9 * MB)


def test_a_region_is_used_again_when_nobody_has_it(arena):
    reader = ArenaReader(arena.address)
    held = 0
    for number in range(20):
        region = arena.write(bytes([number]) * MB)
        assert copy(reader, region) == bytes([number]) * MB
        held = held or held_by(arena)
    assert held_by(arena) <= 2 * held


def test_a_message_that_is_gone_is_no_other_one(arena):
    reader = ArenaReader(arena.address)
    region = arena.write(b"old" * MB)
    where = (region.offset, region.number, region.size)
    del region
    kept = [arena.write(b"new" * MB) for _ in range(2)]
    assert where[0] in [each.offset for each in kept]
    assert reader.read(*where) is None


def test_the_memory_of_many_free_regions_is_given_back(arena, monkeypatch):
    monkeypatch.setattr(module, "IDLE", 4 * MB)
    regions = [arena.write(bytes(MB)) for _ in range(20)]
    assert held_by(arena) >= 20 * MB
    del regions
    last = arena.write(b"x" * MB)
    assert held_by(arena) < 8 * MB
    assert copy(ArenaReader(arena.address), last) == b"x" * MB


def test_regions_linger_for_readers_that_cannot_answer():
    now = [100.0]
    arena = Arena(lambda: now[0])
    reader = ArenaReader(arena.address)
    region = arena.write(b"late" * MB)
    assert region is not None
    where = (region.offset, region.number, region.size)
    arena.linger((region,))
    del region
    kept = [arena.write(b"more" * MB)]
    assert reader.read(*where) == b"late" * MB
    now[0] += module.LINGER + 0.1
    kept += [arena.write(b"more" * MB) for _ in range(2)]
    assert reader.read(*where) is None


def test_where_memory_is_lacking_nothing_is_written_and_nothing_is_lost(arena, monkeypatch):
    kept = arena.write(b"kept" * MB)

    def is_full(*unused):
        raise OSError(errno.ENOSPC, "no space")

    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", is_full)
        assert arena.write(bytes(MB)) is None
    reader = ArenaReader(arena.address)
    assert copy(reader, kept) == b"kept" * MB
    assert copy(reader, arena.write(b"y" * MB)) == b"y" * MB


def test_a_limit_of_address_space_is_no_end():
    code = """
arena = Arena()
used = int(open("/proc/self/statm").read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
resource.setrlimit(resource.RLIMIT_AS, (used + (96 << 20),) * 2)
kept = [arena.write(bytes(10 << 20)) for _ in range(12)]
print(kept.count(None) > 0, arena.write(b"small") is not None)
"""
    assert run(code) == "True True\n"


def test_a_limit_of_files_is_an_error_from_the_start():
    code = """
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20,) * 2)
try:
    Arena()
except OSError:
    print("refused")
"""
    assert run(code) == "refused\n"


def test_a_process_of_another_network_does_not_reach_it(arena):
    wrapper = ("unshare", "--net")
    if subprocess.run([*wrapper, "true"], check=False).returncode:
        pytest.skip("namespaces cannot be made here")
    assert "out of reach" in run(READ, arena.address, wrapper=wrapper)


def test_another_user_is_refused(arena):
    if os.geteuid():
        pytest.skip("only root can be another user")
    assert "another user's" in run("os.setuid(65534)\n" + READ, arena.address)
    code = """
import socket
os.setuid(65534)
with socket.socket(socket.AF_UNIX) as bare:
    bare.connect(chr(0) + sys.argv[1])
    print(bare.recvmsg(1, 100)[:2])
"""
    assert run(code, arena.address) == "(b'', [])\n"
    assert run(READ, arena.address) == ""


def test_a_reader_without_a_free_descriptor_is_told_so(arena):
    code = """
files = []
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
try:
    while True:
        files.append(os.open("/dev/null", os.O_RDONLY))
except OSError:
    os.close(files.pop())  # for the socket
"""
    assert "no descriptor is free" in run(code + READ, arena.address)
    assert run(READ, arena.address) == ""


def test_an_interpreter_that_ends_says_nothing(arena):
    code = """
reader, own = ArenaReader(sys.argv[1]), Arena()
region = own.write(b"mine")
own.linger((own.write(b"late"),))
"""
    program = f"import sys\nfrom dyknow.ros.transport.arena import Arena, ArenaReader\n{code}"
    ended = subprocess.run(
        [sys.executable, "-c", program, arena.address], stderr=subprocess.PIPE, timeout=120
    )
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_an_address_that_nobody_has():
    with pytest.raises(HostError, match="out of reach"):
        ArenaReader("dyknow-of-yesterday")


def test_what_a_killed_owner_wrote_can_be_read(tmp_path):
    code = """
arena = Arena()
region = arena.write(b"last" * (1 << 20))
print(arena.address, region.offset, region.number, region.size, flush=True)
sys.stdin.read()
"""
    program = f"import sys\nfrom dyknow.ros.transport.arena import Arena\n{code}"
    command = [sys.executable, "-c", program]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as owner:
        try:
            address, *where = owner.stdout.readline().split()
            reader = ArenaReader(address)
        finally:
            owner.kill()
    assert reader.read(*map(int, where)) == b"last" * MB
    with pytest.raises(HostError):
        ArenaReader(address)


def test_a_child_that_was_forked_writes_nothing(arena):
    kept = arena.write(b"parent" * MB)
    child = os.fork()
    if not child:
        os._exit(0 if arena.write(bytes(MB)) is None else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert copy(ArenaReader(arena.address), kept) == b"parent" * MB


def test_an_owner_that_had_no_descriptor_hands_out_when_it_has():
    code = """
arena = Arena()
ArenaReader(arena.address)
files, soft = [], resource.getrlimit(resource.RLIMIT_NOFILE)[0]
resource.setrlimit(resource.RLIMIT_NOFILE, (64, soft))
try:
    while True:
        files.append(os.open("/dev/null", os.O_RDONLY))
except OSError:
    os.close(files.pop())  # for the reader's socket, and none for the owner's
for _ in range(3):
    try:
        ArenaReader(arena.address)
    except HostError:
        pass
while files:
    os.close(files.pop())
region = arena.write(b"again")
print(ArenaReader(arena.address).read(region.offset, region.number, region.size))
"""
    assert run(code) == "b'again'\n"


def test_a_reader_can_only_read(arena):
    reader = ArenaReader(arena.address)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.write(reader._file, b"x")
    with pytest.raises(OSError, match="Operation not permitted"):
        os.ftruncate(arena._file, 0)
