# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The state file on disks with real faults, and damaged in every way."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import resource
import shutil
import sqlite3
import stat
from pathlib import Path
from typing import Callable, ContextManager, Dict, Iterator, Tuple

import pytest
from clocks import HandClock
from faulty_disk import full, kept_aside, locked, read_only, small_disk
from hypothesis import example, given
from hypothesis import strategies as st
from property_tests import examples
from unit.manager.world import CAMERA, World

from dyknow.errors import StoreError
from dyknow.manager import store as store_module
from dyknow.manager.store import TABLES, Store

#: Enough to fill several pages, some of them overflowing.
ROWS = {("nodelets", f"/n{i:03}"): f"{i:03} " + "x" * (40 * i) for i in range(60)}
CLAIM = {("claims", "c"): "of a client"}
SOUND = {
    **ROWS,
    **CLAIM,
    ("facts", "revision"): "41",
    **{("transformations", f"t{i}"): "t" * 200 for i in range(200)},
}


def content(file: Store) -> Dict[tuple[str, str], str]:
    return {
        (table, key): text
        for table in ("facts", "transformations", "nodelets", "claims")
        for key, text in file.read(table, lambda key, text: text).items()
    }


def written(path: str, rows: Dict[tuple[str, str], str] = ROWS) -> str:
    file = Store(path)
    file.write(rows)
    file.close()
    return path


def reopened(path: str) -> Dict[tuple[str, str], str]:
    file = Store(path)
    try:
        assert (file.trouble, file.complaint) == ("", "")
        return content(file)
    finally:
        file.close()


@contextlib.contextmanager
def killed(path: str) -> Iterator[Store]:
    """A store whose process is killed: its last changes are in its log alone."""
    with contextlib.closing(Store(path)) as file:
        yield file
        for suffix in ("", "-wal"):
            shutil.copyfile(path + suffix, path + suffix + ".kept")
    for suffix in ("", "-wal"):
        os.replace(path + suffix + ".kept", path + suffix)
    os.remove(path + ".backup")  # which was made at the end


# Trouble: the file is sound


def test_a_disk_that_fills_up_is_named_and_what_it_did_not_take_is_written_later(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clock = HandClock()
    with small_disk(tmp_path / "disk") as disk:
        path = written(str(disk / "state"))
        file = Store(path, clock)
        with full(disk):
            file.write({**CLAIM, ("nodelets", "/n000"): None, ("nodelets", "/big"): "y" * 50_000})
            assert "disk is full" in file.trouble and "free some space" in file.trouble
            assert "rollback" not in caplog.text
            expected = {**ROWS, **CLAIM, ("nodelets", "/big"): "y" * 50_000}
            del expected["nodelets", "/n000"]
            assert content(file) == expected
            clock.time += 10
            file.write_pending()
            assert "disk is full" in file.trouble
        clock.time += 10
        file.write_pending()
        assert file.trouble == ""
        file.close()
        assert reopened(path) == expected
        assert kept_aside(path) == []


def test_what_is_written_later_goes_with_the_next_change_or_look(tmp_path: Path) -> None:
    path = str(tmp_path / "state")
    file = Store(path)
    for write in (lambda: file.write(CLAIM), file.write_pending):
        file.write_later({("nodelets", "/n"): "body"})
        assert ("nodelets", "/n") not in reopened(path)
        write()
        assert content(file) == reopened(path)
        file.write({("nodelets", "/n"): None})
    file.close()


def test_a_trouble_that_goes_on_is_reported_from_time_to_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clock = HandClock()
    path = written(str(tmp_path / "state"))
    file = Store(path, clock)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        file.write(CLAIM)
        for _ in range(130):
            clock.time += 1.0
            file.write_pending()
        reports = [each for each in caplog.records if each.levelno == logging.ERROR]
        assert len(reports) == 3
        assert "locked by another program" in reports[-1].getMessage()
    clock.time += 1.0
    file.write_pending()
    assert caplog.records[-1].getMessage().endswith("is written again; nothing is missing")
    file.close()


@contextlib.contextmanager
def limited(size: int) -> Iterator[None]:
    """Let this process write to no file beyond a size."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


Trouble = Callable[[str], ContextManager[None]]
TROUBLES: Dict[str, Tuple[str, Trouble]] = {
    "full": ("disk", lambda path: full(Path(path).parent)),
    "of no size": ("input/output", lambda path: limited(0)),
    "of 50 bytes": ("input/output", lambda path: limited(50)),
    "of 4 kB": ("input/output", lambda path: limited(4096)),
    "locked": ("locked by another program", locked),
    "read-only": ("read-only", lambda path: read_only(Path(path).parent)),
}


@pytest.mark.parametrize(
    ("trouble", "before"),
    [
        *itertools.product(TROUBLES, ["killed", "closed"]),
        *((each, "none") for each in TROUBLES if each != "locked"),
    ],
)
def test_a_start_with_a_sound_file_that_cannot_be_written_reads_it_and_writes_it_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trouble: str, before: str
) -> None:
    monkeypatch.setattr(store_module, "_START_PATIENCE", 0.1)
    clock, (cause, happens) = HandClock(), TROUBLES[trouble]
    rows = {} if before == "none" else ROWS
    is_small = trouble == "full"  # a mount, which not every machine permits
    with small_disk(tmp_path / "d") if is_small else contextlib.nullcontext(tmp_path) as folder:
        path = str(folder / "state")
        if before == "closed":
            written(path)
        if before == "killed":
            with killed(path) as file:
                file.write(ROWS)
            assert os.path.getsize(path + "-wal") > 0
        with happens(path):
            file = Store(path, clock)
            assert content(file) == rows
            assert cause in file.trouble and file.complaint == ""
            file.write(CLAIM)
            assert content(file) == {**rows, **CLAIM}
            clock.time += 10
            file.write_pending()
            assert file.trouble
        clock.time += 10
        file.write_pending()
        assert file.trouble == ""
        file.close()
        assert reopened(path) == {**rows, **CLAIM}
        assert kept_aside(path) == []


def test_what_cannot_be_read_at_all_is_an_error_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "state"
    path.mkdir()
    with pytest.raises(StoreError, match="cannot be read"):
        Store(str(path))
    assert list(tmp_path.iterdir()) == [path]


# Damage


def damaged(path: str, damage: Callable[[bytearray], bytes]) -> bytes:
    with open(path, "rb") as file:
        broken = bytes(damage(bytearray(file.read())))
    for suffix in ("-wal", "-shm"):
        if os.path.exists(path + suffix):
            os.remove(path + suffix)
    with open(path, "wb") as file:
        file.write(broken)
    return broken


def flip(data: bytearray, where: int, bits: int) -> bytes:
    data[where % len(data)] ^= bits
    return data


def truncate(data: bytearray, where: int, unused: int) -> bytes:
    return data[: where % len(data)]


def zero(data: bytearray, where: int, count: int) -> bytes:
    begin = where % len(data)
    end = min(len(data), begin + 16 * count)
    data[begin:end] = bytes(end - begin)
    return data


Damage = Callable[[bytearray, int, int], bytes]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(str(tmp_path_factory.mktemp("sound") / "state"), SOUND)


def check_start(sound: str, folder: Path, damage: Damage, where: int, extent: int) -> None:
    """Start with a damaged file and no backup: nothing is raised, and the next file works.

    All rows are read, or none are and a complaint says so.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    path = str(folder / "state")
    shutil.copyfile(sound, path)
    broken = damaged(path, lambda data: damage(data, where, extent))
    file = Store(path)
    found = content(file)
    assert file.trouble == ""
    assert found == ({} if file.complaint else SOUND)
    if file.complaint and broken:
        (aside,) = kept_aside(path)
        assert str(aside) in file.complaint
        assert aside.read_bytes()[100:] == broken[100:]  # the header counts who opened it
    file.write({("claims", "new"): "claim"})
    file.close()
    assert reopened(path) == {**found, ("claims", "new"): "claim"}


@examples(60)
@given(st.sampled_from([flip, truncate, zero]), st.integers(0, 10**6), st.integers(1, 255))
@example(flip, 18, 7)  # sqlite takes the file for one that it may only read
@example(flip, 60, 1)  # another format
@example(truncate, 0, 1)
@example(truncate, 1, 1)
@example(zero, 0, 255)
def test_a_start_with_any_damage_works(
    sound: str, tmp_path_factory: pytest.TempPathFactory, kind: Damage, where: int, extent: int
) -> None:
    check_start(sound, tmp_path_factory.getbasetemp() / "damaged", kind, where, extent)


@pytest.mark.long
@pytest.mark.parametrize("kind", [flip, truncate, zero])
def test_a_start_with_damage_at_any_place_works(sound: str, tmp_path: Path, kind: Damage) -> None:
    for where in [*range(200), *range(200, os.path.getsize(sound), 211)]:
        check_start(sound, tmp_path / "damaged", kind, where, 255)


def change_text(path: str) -> None:
    """Change one letter in the text of a row; sqlite sees nothing wrong with it."""
    data = Path(path).read_bytes()
    where = data.index(b"of a client")
    damaged(path, lambda data: data[:where] + b"O" + data[where + 1 :])


def change_format(path: str) -> None:
    damaged(path, lambda data: flip(data, 63, 3))  # as of a file without tables


def no_database(path: str) -> None:
    Path(path).write_bytes(b"no database" * 1000)


def empty(path: str) -> None:
    damaged(path, lambda data: b"")


@pytest.mark.parametrize("damage", [change_text, change_format, no_database, empty])
def test_a_backup_takes_the_place_of_a_damaged_file(
    tmp_path: Path, damage: Callable[[str], None]
) -> None:
    path = written(str(tmp_path / "state"), {**ROWS, **CLAIM})
    damage(path)
    file = Store(path)
    assert content(file) == {**ROWS, **CLAIM}
    (aside,) = kept_aside(path)
    assert f"set aside as '{aside}'; the backup '{path}.backup' of 2" in file.complaint
    assert "60 nodelets, 1 claims" in file.complaint
    file.close()
    assert reopened(path) == {**ROWS, **CLAIM}


@pytest.mark.parametrize("damage", [change_text, os.remove])
def test_a_backup_that_is_damaged_or_away_is_left_out(
    tmp_path: Path, damage: Callable[[str], None]
) -> None:
    """One is away when the manager was killed between the two renames of a backup."""
    path = written(str(tmp_path / "state"))
    written(path, CLAIM)
    damage(path + ".backup")
    change_text(path)
    file = Store(path)
    assert content(file) == ROWS
    assert f"'{path}.backup-2'" in file.complaint
    file.close()


def test_no_backup_is_made_of_what_is_damaged_nor_twice_of_the_same(tmp_path: Path) -> None:
    path = str(tmp_path / "state")
    file = Store(path)
    file.write({**ROWS, **CLAIM})
    file.back_up()
    made = Path(path + ".backup").stat()
    file.back_up()
    assert Path(path + ".backup").stat() == made
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("UPDATE claims SET body = 'of a friend'")
    file.write({("claims", "later"): "and this one"})
    file.back_up()
    expected = {**ROWS, **CLAIM, ("claims", "later"): "and this one"}
    assert "claims 'c' is not what was written" in file.complaint
    assert content(file) == expected
    file.close()
    assert reopened(path) == expected


def test_only_the_owner_may_read_or_hold_the_files(tmp_path: Path) -> None:
    path = str(tmp_path / "deep" / "state")
    file = Store(path)
    file.write(CLAIM)
    file.back_up()
    assert stat.S_IMODE(os.stat(tmp_path / "deep").st_mode) == 0o700
    found = {each.name: stat.S_IMODE(each.stat().st_mode) for each in Path(path).parent.iterdir()}
    assert set(found) >= {"state", "state-wal", "state.backup"}
    assert set(found.values()) == {0o600}
    file.close()
    os.chmod(path, 0o644)  # as earlier versions made it
    reopened(path)
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600


def without_checksums(path: str, rows: Dict[tuple[str, str], str]) -> str:
    """Write a file as earlier versions did."""
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as old:
        old.execute("PRAGMA journal_mode = WAL")
        for table, columns in TABLES.items():
            old.execute(
                f"CREATE TABLE {table} ({columns[0]} TEXT PRIMARY KEY, {columns[1]} TEXT NOT NULL)"
                " WITHOUT ROWID"
            )
        old.executemany("INSERT INTO nodelets VALUES (?, ?)", [(k[1], t) for k, t in rows.items()])
        old.execute("PRAGMA user_version = 1")
    return path


def without_children(path: str, rows: Dict[tuple[str, str], str]) -> str:
    """Write a file as earlier versions did that had checksums."""
    with contextlib.closing(sqlite3.connect(written(path, rows))) as old:
        old.execute("DROP TABLE children")
        old.execute("PRAGMA user_version = 2")
    return path


@pytest.mark.parametrize("write", [without_checksums, without_children])
def test_a_file_of_an_earlier_version_is_taken_over(
    tmp_path: Path, write: Callable[[str, Dict[tuple[str, str], str]], str]
) -> None:
    path = write(str(tmp_path / "state"), ROWS)
    assert reopened(path) == ROWS
    with contextlib.closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (3,)
        (without,) = connection.execute(
            "SELECT count(*) FROM nodelets WHERE checksum = 0"
        ).fetchone()
        assert without == 0


def test_a_file_of_an_earlier_version_that_cannot_be_written_is_read(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        path = without_checksums(str(disk / "state"), ROWS)
        with read_only(disk):
            file = Store(path)
            assert content(file) == ROWS and "read-only" in file.trouble


def test_a_damaged_file_on_a_full_disk_stays_until_its_successor_is_there(tmp_path: Path) -> None:
    clock = HandClock()
    with small_disk(tmp_path / "disk") as disk:
        path = written(str(disk / "state"))
        broken = damaged(path, lambda data: flip(data, 18, 7))
        with full(disk):
            for _ in range(2):  # killed, and started again
                file = Store(path, clock)
                assert content(file) == ROWS
                assert "damaged" in file.trouble and "full" in file.trouble
                assert Path(path).read_bytes()[100:] == broken[100:]
                file.write(CLAIM)
        clock.time += 10
        file.write_pending()
        assert file.trouble == "" and "set aside" in file.complaint
        file.close()
        assert reopened(path) == {**ROWS, **CLAIM}


@pytest.mark.parametrize("renames", range(4))
def test_a_kill_while_the_file_is_replaced_goes_back_to_no_older_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, renames: int
) -> None:
    """The last changes of the old file are in its log alone."""
    path = str(tmp_path / "state")
    with killed(path) as store:
        store.write({("facts", "revision"): "1"})
        with contextlib.closing(sqlite3.connect(path)) as other:
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        store.write({("facts", "revision"): "2"})
    left = iter(range(renames))

    def replace(source, target, rename=os.replace):
        next(left)
        rename(source, target)

    with monkeypatch.context() as patched, contextlib.suppress(StopIteration):
        patched.setattr(store_module.os, "replace", replace)
        store_module._replace(path, {("facts", "revision"): "2"})
    with contextlib.closing(Store(path)) as store:
        assert store.number("revision") == 2
    assert not os.path.exists(path + ".new") or not renames


def test_a_replacement_that_was_interrupted_is_completed(tmp_path: Path) -> None:
    path = written(str(tmp_path / "state"))
    os.replace(path, path + ".new")  # the old one was set aside just before
    assert reopened(path) == ROWS


def test_a_file_that_is_damaged_while_it_is_open_is_replaced(tmp_path: Path) -> None:
    path = written(str(tmp_path / "state"))
    file = Store(path)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("DROP TABLE claims")
    file.write(CLAIM)
    assert file.trouble == ""
    file.close()
    assert reopened(path) == {**ROWS, **CLAIM}


def remove(path: str) -> None:
    for suffix in ("", "-wal", "-shm"):
        os.remove(path + suffix)


def move(path: str) -> None:
    shutil.move(os.path.dirname(path), os.path.dirname(path) + "-moved")


def exchange(path: str) -> None:
    os.replace(written(path + ".other", {("facts", "revision"): "7"}), path)


@pytest.mark.parametrize("take", [remove, move, exchange])
@pytest.mark.parametrize("look", [Store.write_pending, Store.back_up, lambda file: file.end()])
def test_a_file_that_is_gone_is_written_again(
    tmp_path: Path, take: Callable[[str], None], look: Callable[[Store], None]
) -> None:
    path = str(tmp_path / "folder" / "state")
    file = Store(path)
    file.write(ROWS)
    file.write(CLAIM)
    take(path)
    look(file)
    assert "it was removed or replaced" in file.complaint
    assert ("set aside" in file.complaint) == (take is exchange)
    assert bool(kept_aside(path)) == (take is exchange)
    expected = content(file)
    file.back_up()
    os.replace(path + ".backup", path + ".copy")
    file.close()
    assert reopened(path) == reopened(path + ".copy") == expected


def test_no_revision_goes_back_where_a_backup_takes_the_place_of_a_file(tmp_path: Path) -> None:
    """The backup was made before the last block of revisions was reserved."""
    path, backup, earlier = (tmp_path / name for name in ("state", "state.backup", "earlier"))
    world = World(str(path))
    world.store.back_up()
    shutil.copyfile(backup, earlier)
    world.kill_manager()
    for rate in ("10", "20", "30"):
        world.manager.add_transformation(CAMERA.replace(">30<", f">{rate}<"))
    before = world.manager.graph.revision, world.manager.library.revision
    world.store.close()
    path.write_bytes(b"cut off")
    os.replace(earlier, backup)
    for _ in range(2):  # the second life finds nothing damaged
        world.open()
        assert world.manager.graph.revision > before[0]
        assert world.manager.library.revision > before[1]
        world.store.close()
