# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Guards of several owners: they add up."""

from __future__ import annotations

import threading

import pytest
from unit.nodelet.fakes import Message, World

import dyknow
from dyknow.errors import Denied, InvalidConfiguration
from dyknow.guards import NO_GUARDS, Guards, together
from dyknow.proxy.proxy import NodeletProxy
from dyknow.ros.nodelets import process_guards
from dyknow.ros.nodelets.process_guards import ProcessGuards
from dyknow.ros.wire.messages import guards_from, guards_message


def test_guards_add_up():
    ours = Guards(denied_topics=("/e_stop",), string_length=100, array_length=5000)
    theirs = Guards(denied_topics=("*/cmd_vel",), read_only=True, array_length=10)
    both = Guards(("*/cmd_vel", "/e_stop"), read_only=True, string_length=100, array_length=10)
    assert together([ours, theirs]) == together([theirs, ours]) == both
    assert together([both, NO_GUARDS]) == both, "a lenient owner lifts nothing"
    assert together([]) == NO_GUARDS


def test_a_topic_and_a_program_have_to_be_on_the_allow_list_of_every_owner():
    both = together(
        [
            Guards(allowed_topics=(("/robot/*", "/tf"),), allowed_programs=(("tools/*",),)),
            Guards(allowed_topics=(("*/image", "/tf"),), denied_topics=("/robot/left/*",)),
            NO_GUARDS,
        ]
    )
    for topic in ("/robot/image", "/tf", "/rosout", "/clock"):
        both.check_topic(topic)
    for topic in ("/robot/scan", "/lab/image", "/robot/left/image"):
        with pytest.raises(Denied):
            both.check_topic(topic)
    both.check_program("tools/relay")
    with pytest.raises(Denied, match="allowed_programs"):
        both.check_program("rosbag/record")


def test_programs_of_services_are_refused_and_those_of_own_files_are_not():
    closed = together([Guards(remote_programs=False), NO_GUARDS])
    closed.check_program("tools/relay", is_own=True)
    with pytest.raises(Denied, match="remote_programs"):
        closed.check_program("tools/relay")


class TestOneCheckForEveryTopic:
    """The bus asks the guards about all topics but those on which people launch a node."""

    GUARDS = Guards(denied_topics=("/e_stop",))

    def nodelet(self, bound=True, **remappings):
        context = World(guards=lambda: self.GUARDS, bound=bound).context("/n", **remappings)
        handle = dyknow.nodelet.handle.PlainNodeHandle(context, "/")
        return handle, dyknow.NodeHandle(handle), NodeletProxy.of(context)

    def test_a_plain_handle(self):
        plain, _, _ = self.nodelet()
        for connect in (
            lambda: plain.Publisher("e_stop", Message),
            lambda: plain.Subscriber("/e_stop", Message, print),
        ):
            with pytest.raises(Denied, match="'/e_stop'"):
                connect()
        plain.Publisher("other", Message)

    def test_a_port_that_a_load_remaps(self):
        _, handle, proxy = self.nodelet(remappings={"/out": "/e_stop"})
        with pytest.raises(Denied, match="'/e_stop'"):
            handle.Publisher("out", Message)
        assert proxy.get_config() == []

    def test_what_people_launch_begins_where_they_say(self):
        plain, handle, proxy = self.nodelet(bound=False, remappings={"/out": "/e_stop"})
        plain.Publisher("e_stop", Message)
        handle.Publisher("out", Message)
        handle.Subscriber("in", Message, print)
        with pytest.raises(InvalidConfiguration, match="deny list"):
            proxy.set_config([("in", "/e_stop")])


def test_guards_survive_their_message():
    guards = Guards(
        denied_topics=("/e_stop",),
        allowed_topics=(("/a/*", "/b"),),
        allowed_programs=(("tools/*",),),
        remote_programs=False,
        read_only=True,
        string_length=10,
        array_length=2,
    )
    assert guards_from(guards_message(guards)) == guards
    assert guards_from(guards_message(NO_GUARDS)) == NO_GUARDS


def test_a_port_without_a_topic_is_on_no_list():
    Guards(allowed_topics=(("/cam/*",),), denied_topics=("*",)).check_topic("")


BOTH = [guards_message(Guards(denied_topics=(topic,))) for topic in ("/e_stop", "/cmd_vel")]


def test_guards_that_two_managers_hand_over_at_once_add_up(monkeypatch):
    """The first manager's are being read while those of the second one come."""
    guards, threads = ProcessGuards(), []

    def slow(message):
        if not threads:
            threads.append(threading.Thread(target=guards.hand_over, args=("/two", BOTH[1])))
            threads[0].start()
            threads[0].join(0.2)
        return guards_from(message)

    monkeypatch.setattr(process_guards, "guards_from", slow)
    guards.hand_over("/one", BOTH[0])
    threads[0].join(10.0)
    for topic in ("/e_stop", "/cmd_vel"):
        with pytest.raises(Denied):
            guards.current().check_topic(topic)
