# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The cost of a request: calls to the host, worlds, writes, and calls within Python."""

from __future__ import annotations

import collections
import gc
import sys
from types import FrameType
from typing import Any, Counter, List, Set

import pytest
from clocks import patch_here
from unit.manager.field import LIBRARY, Field, library, specification

from dyknow.errors import NoPlanFound
from dyknow.locks import CheckedLock
from dyknow.manager.claims.world import World
from dyknow.manager.store import Store
from dyknow.model.streams import StreamRequest
from dyknow.simulated import SimulatedManagerClient

INT = "std_msgs/Int32"


def chain(length: int) -> str:
    """Write a library in which each transformation needs the stream of the one before."""
    texts = []
    for number in range(length):
        ports = {"in": ("in", [f"Step{number}(x)"])} if number else {}
        ports["out"] = ("out", [f"Step{number + 1}(x)"])
        texts.append(specification(f"step {number}", f"pkg/Step{number}", ports, 1, INT))
    return library(*texts)


def client_with_chain(length: int) -> SimulatedManagerClient:
    client = SimulatedManagerClient()
    client.add_transformation(chain(length))
    client.settle()
    client.host.calls.clear()
    return client


def counted(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> List[str]:
    """Count the calls of a method in this thread from now on."""
    found: List[str] = []
    method = getattr(owner, name)

    def called(*args: Any, **kwds: Any) -> Any:
        found.append(name)
        return method(*args, **kwds)

    patch_here(monkeypatch, owner, name, called)
    return found


@pytest.mark.parametrize("length", [1, 2, 4, 8])
def test_a_chain_is_spawned_connected(length: int, monkeypatch: pytest.MonkeyPatch) -> None:
    client = client_with_chain(length)
    worlds = counted(monkeypatch, World, "__init__")
    writes = counted(monkeypatch, Store, "write")
    got = client.acquire_stream(StreamRequest(f"Step{length}(x)"))
    calls = collections.Counter(operation for operation, _ in client.host.calls)
    assert len(got.spawned) == calls["load"] == length
    assert calls["connect"] == 0
    assert len(worlds) <= 2 * length + 1
    assert len(writes) <= length + 1
    for number in range(1, length):
        topics = {each.name: each.topic for each in client.get_config(f"/step_{number}_1")}
        assert topics["in"] == f"/step_{number - 1}_1/out"


def test_an_acquire_takes_few_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    # The first acquire of a process also fills the caches of its parsers.
    client_with_chain(4).acquire_stream(StreamRequest("Step4(x)"))
    client = client_with_chain(4)
    locks = counted(monkeypatch, CheckedLock, "acquire")
    calls: Counter[str] = collections.Counter()
    functions: Set[object] = set()

    def profile(frame: FrameType, event: str, argument: object) -> None:
        if event == "call" and "dyknow/manager/" in frame.f_code.co_filename:
            calls[frame.f_code.co_filename] += 1
            functions.add(frame.f_code)

    sys.setprofile(profile)
    try:
        client.acquire_stream(StreamRequest("Step4(x)"))
    finally:
        sys.setprofile(None)
    assert sum(calls.values()) <= 1_335
    assert len(functions) <= 372
    assert len(calls) <= 30
    assert 0 < len(locks) <= 70


def test_a_round_without_news_reads_no_world_and_calls_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    client = client_with_chain(4)
    client.acquire_stream(StreamRequest("Step4(x)"))
    for _ in range(3):
        client.settle()
    worlds = counted(monkeypatch, World, "__init__")
    searches = counted(monkeypatch, World, "fits")
    writes = counted(monkeypatch, Store, "write")
    client.host.calls.clear()
    for _ in range(5):
        client.settle()
    assert (worlds, searches, writes) == ([], [], [])
    assert {operation for operation, _ in client.host.calls} <= {"published"}


# Old requests, and nodelets that are gone, are forgotten


def kept() -> int:
    """The number of living instances of the planner's classes."""
    gc.collect()
    modules = (str(type(each).__module__) for each in gc.get_objects())
    return sum(module.startswith("dyknow.manager.planning") for module in modules)


def test_tags_that_were_asked_for_once(field: Field) -> None:
    after: List[int] = []
    for number in range(100):
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest(f"Nothing({number})"), dry_run=True)
        if number in (20, 99):
            after.append(kept())
    assert after[1] == after[0]
    field.flowing()


def test_labels_that_were_replaced(field: Field) -> None:
    after: List[int] = []
    for cost in range(30):
        field.manager.add_transformation(LIBRARY.replace('cost="5"', f'cost="{cost}"'))
        field.manager.add_transformation(LIBRARY.replace("YUV(field)", f"YUV(field{cost})"))
        field.manager.add_transformation(LIBRARY.replace("YUV(?where)", f"YUV{cost}(?where)"))
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest("Nothing(x)"), dry_run=True)
        if cost in (9, 29):
            after.append(kept())
    assert after[1] == after[0]
    field.manager.add_transformation(LIBRARY)
    field.flowing()


def test_claims_that_could_not_be_made_and_ended(field: Field) -> None:
    for number in range(20):
        with pytest.raises(NoPlanFound) as raised:
            field.acquire(f"Nothing({number})")
        field.tick()
        field.reconciler.release(raised.value.claim_id)
        field.tick()
    assert field.reconciler._repair._unplannable == {}
