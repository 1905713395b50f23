# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""set_config: everything is checked first, then all is switched together, or nothing."""

from __future__ import annotations

import pytest
from clocks import in_thread, join
from unit.nodelet.fakes import AnyMessage, Message, OtherMessage, numbers
from unit.proxy.bench import Bench

from dyknow.errors import (
    DuplicatePort,
    InvalidConfiguration,
    InvalidName,
    PeerTimeout,
    RemappedTopic,
    TypeMismatch,
    UnknownPort,
    UnloadedMeanwhile,
)


class Ported(Bench):
    """A bench with ports."""

    def __init__(self, **options):
        super().__init__(**options)
        self.got = []
        self.out = self.nh.Publisher("out", Message, queue_size=10)
        self.nh.Publisher("other_out", OtherMessage, queue_size=10)
        self.sub = self.nh.Subscriber("in", Message, self.got.append)
        self.nh.Subscriber("any", AnyMessage, self.got.append)

    def state(self):
        reconfigurations = self.proxy.get_statistics().reconfigurations
        return self.proxy.get_config(), self.world.registrations, reconfigurations

    def refuse(self, config):
        """Set a configuration that must be refused without any effect; returns its problems."""
        before = self.state()
        with pytest.raises(InvalidConfiguration) as caught:
            self.proxy.set_config(config)
        assert self.state() == before
        assert str(caught.value).startswith("/ns/nodelet: nothing was changed: ")
        return caught.value.problems


@pytest.fixture(name="bench")
def _bench():
    return Ported()


def test_topics_resolve_like_those_of_the_nodelet_without_the_remappings_of_its_load():
    bench = Ported(remappings={"/ns/image": "/elsewhere"})
    for text, topic in (("image/", "/ns/image"), ("~image", "/ns/nodelet/image")):
        bench.proxy.set_config([("in", text)])
        assert bench.topics()["in"] == topic


def test_ports_that_are_not_named_stay_and_an_equal_configuration_changes_nothing(bench):
    bench.proxy.set_config([("in", "/a"), ("out", "/b")])
    made = len(bench.world.transport.made)
    bench.proxy.set_config([("in", "/c")])
    assert bench.topics()["out"] == "/b"
    assert len(bench.world.transport.made) == made + 1
    told = []
    bench.nh.set_reconfigure_callback(lambda *maps: told.append(maps))
    for config in ([], [("in", "/c")], [("any", "")]):
        bench.proxy.set_config(config)
    bench.world.drain()
    assert told == []
    assert bench.proxy.get_statistics().reconfigurations == 2


#: Wrong configurations and their errors; `/third` carries another type, `/remapped` is remapped.
REFUSED = [
    ([("nose", "/a"), ("in", "/b")], [UnknownPort]),
    ([("in", "/a"), ("out", "/c"), ("in", "/b")], [DuplicatePort]),
    ([("in", "/a"), ("in", "/a")], [DuplicatePort]),
    ([("in", "/third")], [TypeMismatch]),
    ([("in", "/a"), ("other_out", "/a"), ("nose", "/b")], [TypeMismatch, UnknownPort]),
    # A port of any type does not hide the type of a topic, or of another port.
    ([("any", "/third"), ("in", "/third")], [TypeMismatch]),
    ([("in", "/third"), ("any", "/third")], [TypeMismatch]),
    ([("any", "/a"), ("in", "/a"), ("other_out", "/a")], [TypeMismatch]),
    ([("in", "/remapped")], [RemappedTopic]),
    (
        [("in", "/third"), ("out", "a b"), ("nose", "/a"), ("any", "/a"), ("any", "/b")],
        [DuplicatePort, TypeMismatch, InvalidName, UnknownPort],
    ),
]


class TestRefusals:
    @pytest.mark.parametrize(("config", "problems"), REFUSED)
    def test_all_that_is_wrong_is_reported_at_once(self, bench, config, problems):
        bench.world.transport.types["/third"] = "test/Third"
        bench.world.node.remappings["/remapped"] = "/b"
        assert [type(problem) for problem in bench.refuse(config)] == problems

    def test_a_problem_names_the_port(self, bench):
        bench.probe.Publisher("/t", OtherMessage)
        unknown, twice, mismatch = sorted(
            map(str, bench.refuse([("nose", "/a"), ("out", ""), ("out", "/b"), ("in", "/t")])),
            key=lambda text: ("'nose'" not in text, "'out'" not in text),
        )
        assert unknown == "unknown port 'nose'; known ports: any, in, other_out, out"
        assert "'out'" in twice
        assert "'/t' carries test/OtherMessage" in mismatch and "port 'in'" in mismatch

    @pytest.mark.parametrize("topic", ["a b", "1", "//a", "/", "~", "a//b", "/a/~b", " ", "-"])
    def test_an_invalid_topic(self, bench, topic):
        (problem,) = bench.refuse([("in", topic), ("out", "/b")])
        assert isinstance(problem, InvalidName)
        assert problem.name == topic
        assert "topic name" in str(problem)

    def test_a_topic_that_is_about_to_be_used_has_its_type_already(self, bench):
        refused = []

        def come_up(topic):
            bench.world.transport.on_register = lambda topic: None
            with pytest.raises(TypeMismatch):
                bench.probe.Publisher("/b", OtherMessage)
            refused.append(topic)

        bench.world.transport.on_register = come_up
        bench.proxy.set_config([("in", "/a"), ("out", "/b")])
        assert refused == ["/a"]
        assert bench.world.registrations == [("publisher", "/b"), ("subscriber", "/a")]

    def test_a_registration_that_fails(self, bench):
        bench.proxy.set_config([("in", "/a"), ("out", "/b")])
        bench.world.transport.refused["/bad"] = PeerTimeout("the master", 1.0)
        told = []
        bench.nh.set_reconfigure_callback(lambda *maps: told.append(maps))
        with pytest.raises(PeerTimeout):
            bench.proxy.set_config([("in", "/good"), ("out", "/bad")])
        bench.world.drain()
        assert told == []
        assert bench.topics()["in"] == bench.sub.name == "/a"
        assert bench.topics()["out"] == bench.out.name == "/b"
        assert bench.world.registrations == [("publisher", "/b"), ("subscriber", "/a")]
        assert bench.proxy.get_statistics().reconfigurations == 1

    def test_a_registration_that_fails_after_the_switch_is_told_and_the_config_true(self, bench):
        # A topic that is alive here is switched to at once, and registered afterwards.
        bench.probe.Subscriber("/bad", Message, print)
        bench.probe.Publisher("/good", Message)
        bench.proxy.set_config([("in", "/a"), ("out", "/b")])
        bench.world.transport.refused["/bad"] = ValueError("headers")
        changes = []
        bench.proxy.on_change = lambda: changes.append(bench.topics()["out"])
        with pytest.raises(ValueError, match="headers"):
            bench.proxy.set_config([("out", "/bad"), ("in", "/good")])
        assert bench.topics()["in"] == bench.sub.name == "/good"
        assert bench.topics()["out"] == bench.out.name == "/bad"
        assert changes == ["/bad"]
        assert ("publisher", "/b") not in bench.world.registrations


def test_any_fits_every_topic_and_the_config_shows_it(bench):
    other = bench.probe.Publisher("/a", OtherMessage, latch=True)
    other.publish(1)
    bench.proxy.set_config([("any", "/a")])
    bench.world.drain()
    assert numbers(bench.got) == [1]
    shown = [(p.name, p.direction, p.datatype) for p in bench.proxy.get_config()]
    assert shown == [
        ("out", "out", "test/Message"),
        ("other_out", "out", "test/OtherMessage"),
        ("in", "in", "test/Message"),
        ("any", "in", "*"),
    ]
    other.unregister()
    bench.proxy.set_config([("in", "/a")])  # it has no type now


class TestUnload:
    def test_before(self, bench):
        bench.out.unregister()  # so that nothing would be switched
        bench.context.close()
        for port in ("in", "out"):
            with pytest.raises(UnloadedMeanwhile):
                bench.proxy.set_config([(port, "/a")])

    def test_a_handle_unregistered_during_the_switch_does_not_fail_it(self, bench):
        second = bench.nh.Subscriber("in", Message, bench.got.append)
        once = [second]

        def unregister(topic):
            if once:
                join(in_thread(once.pop().unregister))

        bench.world.transport.on_register = unregister
        bench.proxy.set_config([("in", "/a"), ("out", "/b")])
        assert bench.topics()["in"] == bench.sub.name == "/a"
        assert bench.world.registrations == [("publisher", "/b"), ("subscriber", "/a")]
