# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads that the system refuses (``ulimit -u``, ``pids.max``), and exceptions in threads."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest
import rospy
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from dyknow_msgs.msg import NodeletPorts
from rospy.impl import registration
from rospy.topics import _SubscriberImpl
from sensor_msgs.msg import Image
from unit.nodelet.fakes import Idle, Message, World

from dyknow import periodic
from dyknow.model.graph import Model
from dyknow.nodelet.hand_over import HandOvers
from dyknow.periodic import ControlLoop, PeriodicWorker
from dyknow.ros import stream_session
from dyknow.ros.bonding import bonds
from dyknow.ros.manager.services import ModelTopic
from dyknow.ros.nodelets.announcements import Announcer
from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts.process_view import process_views
from dyknow.ros.scripts.sandbox import Sandbox
from dyknow.ros.transport.outbound import Outbound
from dyknow.ros.transport.shared_memory import SharedMemory


def test_the_next_timer_starts_the_thread_of_the_timers(limit):
    world, fired = World(), threading.Event()
    with limit.reaches("dyknow-timers"):
        world.handle().Timer(1.0, lambda event: pytest.fail("it was not made"))
    world.handle().Timer(1.0, lambda event: fired.set())
    world.ticker.advance(1.0)
    world.ticker.next_due(PATIENCE)
    world.drain()
    assert fired.is_set()
    world.close()


def test_an_unload_calls_on_shutdown_and_frees_the_name(limit, caplog):
    ended = []

    class Parting(Idle):
        def on_shutdown(self):
            ended.append(self.name)
            raise ValueError("not so fast")

    world = World()
    loader = world.loader(parting=Parting)
    for _ in range(2):
        limit.refuse("")
        loader.load("/n", "parting")
        limit.refuse("on_shutdown")
        loader.unload("/n")
    assert ended == ["/n", "/n"]
    assert "the unload itself calls on_shutdown" in caplog.text
    loader.close()
    world.close()


def test_nodelets_are_freed_after_the_next_unload(limit, caplog):
    world = World()
    loader = world.loader(idle=Idle)
    limit.refuse("freeing nodelets")
    loader.load("/n", "idle")
    loader.unload("/n")
    assert "/n is freed after the next unload" in caplog.text
    limit.refuse("")
    loader.load("/n", "idle")
    loader.unload("/n")
    eventually(lambda: not loader.leftovers._left and not loader.leftovers._is_examining)
    world.close()


def test_a_loop_starts_the_missing_threads_with_the_next_attempt(limit):
    loop, ran = ControlLoop(2, name="looping"), threading.Semaphore(0)
    with limit.reaches("looping", spared=1):
        loop.start()
    assert not loop.started
    loop.start()
    limit.refuse("looping")
    loop.add("standing", ran.release, after=0.0)  # other threads run it meanwhile
    assert ran.acquire(timeout=PATIENCE)
    assert len(loop._threads) == 2
    limit.refuse("")
    loop.once("once", ran.release)
    assert ran.acquire(timeout=PATIENCE)
    assert len(loop._threads) == 3
    loop.close(PATIENCE)
    assert not loop.running


def test_a_worker_can_be_started_again(limit):
    worker, ran = PeriodicWorker("working", lambda: ran.set()), threading.Event()
    with limit.reaches("working"):
        worker.start()
    worker.start()
    worker.wake()
    wait_for(ran)
    worker.close()


def test_a_connection_that_got_no_thread_sends_everything_with_the_next_message(limit):
    here, there = socket.socketpair()
    for end, option in ((here, socket.SO_SNDBUF), (there, socket.SO_RCVBUF)):
        end.setsockopt(socket.SOL_SOCKET, option, 4096)
    connection = SimpleNamespace(
        socket=here, name="connection", done=False, stat_num_msg=0, stat_bytes=0
    )
    outbound = Outbound(connection, None, None)
    limit.refuse("sending")
    sent = [bytes([number]) * 50_000 for number in range(3)]
    for message in sent[:2]:
        outbound.write_data(message)
    limit.refuse("")
    outbound.write_data(sent[2])
    received = bytearray()
    there.settimeout(PATIENCE)
    while len(received) < 150_000:
        received += there.recv(65536)
    assert received == b"".join(sent)
    eventually(outbound.is_idle)
    here.close()
    there.close()


def test_a_switch_leaves_its_old_topic_without_a_thread_too(limit, caplog):
    world = World()
    ends = [world.handle().Publisher(name, Message, queue_size=1) for name in ("a", "b")]
    world.transport.made[0].drain = lambda seconds: False
    limit.refuse("dyknow-drain")
    world.bus.rewire([(each.publication, f"{each.name}/new") for each in ends])
    assert "may be lost" in caplog.text
    assert world.registrations == [("publisher", "/a/new"), ("publisher", "/b/new")]
    assert world.bus._leaving == []
    world.close()


def test_a_move_that_got_no_thread_is_not_begun(limit):
    world = World()
    loader = world.loader(idle=Idle)
    unload = functools.partial(loader.unload, "/n")
    moves = HandOvers(loader, lambda datatype: Message, unload)
    loader.load("/n", "idle")
    for step in (moves.note, lambda name: moves.park(name, [])):
        with limit.reaches("moving"):
            step("/n")
        assert moves._moves == {}
    moves.park("/n", [])
    limit.refuse("moving")
    moves.take("/n", [])
    moves.close()
    loader.close()
    world.close()


def memories() -> set[str]:
    """The descriptors of shared memory."""
    found = set()
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # closed just now
            found |= {each.name} if "memfd:dyknow" in os.readlink(each) else set()
    return found


def test_memory_that_got_no_thread_is_made_for_the_next_subscriber(limit):
    handler = SharedMemory(is_wanted=True)
    before = memories()
    limit.refuse("handing out")
    for _ in range(2):
        assert handler._made() is None
    assert memories() <= before  # earlier tests may still close theirs
    limit.refuse("")
    assert handler._made() is not None


def test_a_publisher_whose_connection_got_no_thread_is_connected_later(limit, monkeypatch):
    subscriber = _SubscriberImpl("/t", Image)
    manager = SimpleNamespace(get_subscriber_impl=lambda topic: subscriber)
    monkeypatch.setattr(registration, "_topic_manager", manager)
    monkeypatch.setattr(SharedMemory, "_reader", lambda handler, address: address)
    limit.refuse("/t")
    where = ["SHMROS", "localhost", 1, "address"]
    code, text, _ = SharedMemory(True).create_transport("/t", "http://peer:1", where)
    assert (code, subscriber.has_connection("http://peer:1")) == (0, False)
    assert "can't start new thread" in text


def test_a_bond_that_got_no_thread_is_not_made(limit):
    made = bonds.Bonds("/bond")
    for _ in range(2):
        with limit.reaches("bonds"):
            made.add("id", lambda: None)
    assert made._table.next_due() is None


def test_a_script_does_not_wait_for_a_thread_that_it_did_not_get(limit):
    sandbox, ran = Sandbox("sandbox"), threading.Event()
    thread = process_views(sandbox)["threading"]().Thread(target=ran.set, name="refused")
    with limit.reaches("refused"):
        thread.start()
    assert sandbox.threads == []
    sandbox.join()
    thread.start()
    join(thread)
    assert ran.is_set()
    with pytest.raises(RuntimeError, match="only be started once"):
        thread.start()


def test_the_thread_for_finalizers_is_started_by_the_next_sandbox(limit, monkeypatch):
    monkeypatch.setattr(sandbox_module, "_is_deferring", False)
    with limit.reaches("calls of finalizers"):
        Sandbox("sandbox")
    assert not sandbox_module._is_deferring
    Sandbox("sandbox")
    assert sandbox_module._is_deferring


# Threads go on after any exception in them


class Fault:
    """Raises the first time, and then does its work."""

    def __init__(self, work=lambda *arguments, **kwds: None):
        self._work = work
        self.is_due = True
        self.done = []

    def __call__(self, *arguments, **kwds):
        if self.is_due:
            self.is_due = False
            raise RuntimeError("injected")
        self.done.append(arguments)
        return self._work(*arguments, **kwds)


@pytest.fixture
def topic(monkeypatch):
    """Stands for publishers and subscribers; its first publish raises an unexpected error."""
    topic = mock.Mock(publish=Fault(), get_num_connections=lambda: 1)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **options: topic)
    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: topic)
    monkeypatch.setattr(rospy.Time, "now", classmethod(lambda cls: rospy.Time()))
    monkeypatch.setattr(periodic, "RETRY", 0.01)
    monkeypatch.setattr(bonds, "RETRY", 0.01)
    return topic


@pytest.mark.parametrize("where", ["take", "before", "publish"])
def test_the_model_is_published_although_something_failed(topic, where):
    model = Model(1, 1, ())
    take, before = Fault(lambda: model), Fault()
    take.is_due, before.is_due = where == "take", where == "before"
    topic.publish.is_due = where == "publish"
    messages: Any = SimpleNamespace(topic=lambda model: model)
    models = ModelTopic(take, messages, before)
    with pytest.raises(RuntimeError, match="injected"):
        models.publish()
    for _ in range(2):
        models.publish()
    assert topic.publish.done == [(model,)]


def test_a_change_is_announced_although_it_failed_at_first(topic):
    announcer = Announcer(lambda name: NodeletPorts(name, True, [], "", ""))
    with contextlib.closing(announcer):
        announcer.start()
        announcer.announce("/a")
        eventually(lambda: topic.publish.done)
    assert "/a" in str(topic.publish.done[0][0])


def test_heartbeats_of_a_client_go_on(topic, monkeypatch):
    monkeypatch.setattr(stream_session.Constants, "DEFAULT_HEARTBEAT_PERIOD", 0.01)
    with contextlib.closing(stream_session.ClientBond("/manager")):
        eventually(lambda: len(topic.publish.done) >= 2)


def test_leases_are_renewed_although_one_of_them_raises(topic, monkeypatch):
    monkeypatch.setattr(stream_session, "ClientBond", lambda manager: SimpleNamespace(close=int))
    monkeypatch.setattr(stream_session, "_RETRY", 0.01)
    renew = Fault()
    client: Any = mock.Mock(manager="/manager", renew_stream=renew, list_streams=lambda: ())
    with contextlib.closing(stream_session.StreamSession.open(client)) as session:
        for name in ("first", "second"):
            session.add(mock.Mock(claim_id=name, lease=0.03))
        eventually(lambda: len(renew.done) >= 4)
    assert {arguments[0] for arguments in renew.done} == {"first", "second"}


def test_bonds_are_served_on(topic, monkeypatch):
    topic.publish.is_due = False
    made = bonds.Bonds("/bond")
    tick = Fault(made._table.tick)
    monkeypatch.setattr(made._table, "tick", tick)
    made.add("b", lambda: None)
    eventually(lambda: tick.done)
    join(in_thread(lambda: made.close(0.01)))
