# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Companions: a second form of a port's messages, on a topic below that of the port."""

from __future__ import annotations

from dataclasses import replace

import pytest
from unit.nodelet.fakes import Message, OtherMessage, World, numbers
from unit.proxy.bench import Bench

from dyknow.errors import Denied, InvalidConfiguration, PortConflict, TypeMismatch
from dyknow.guards import Guards
from dyknow.model.graph import NodeletKind, NodeletStatus, PortState, State, moved_ports
from dyknow.nodelet.leases import Leases
from dyknow.nodelet.middleware import Codec


class Pressed(Message):
    """The form, whose number is negative."""

    _type = "test/Pressed"
    _md5sum = "pressed"


class Press:
    """Counts its encodings; a message of 0 has no form, and a form of 0 no message."""

    def __init__(self):
        self.encoded = 0
        self.codec = Codec("pressed", Pressed, self.encode, self.decode)

    def encode(self, message):
        self.encoded += 1
        return Pressed(pressed(message))

    def decode(self, form):
        return Message(pressed(form))


def pressed(message):
    if message.number == 0:
        raise ValueError("nothing to press")
    return -message.number


class PressedBench(Bench):
    """A nodelet whose ports have the form, unless ``on`` names the ports that have it."""

    def __init__(self, *on, **options):
        super().__init__(**options)
        self.press = Press()
        self.world.transport.codecs["pressed"] = self.press.codec
        for name in on or ("",):
            key = "/ns/nodelet/" + "/".join(filter(None, (name, "image_transport")))
            self.world.node.parameters[key] = "pressed"
        self.got = []

    def listen(self, topic, datatype=Message):
        got = []
        self.probe.Subscriber(topic, datatype, got.append)
        return got


@pytest.fixture(name="bench")
def _bench():
    return PressedBench()


def test_an_out_port_publishes_both_and_encodes_for_subscribers_alone(bench):
    out = bench.nh.Publisher("out", Message, queue_size=1)
    bench.connect(out="/a")
    assert bench.topics() == {"out": "/a", "out/pressed": "/a/pressed"}
    plain = bench.listen("/a")
    out.publish(1)
    assert bench.press.encoded == 0
    form = bench.listen("/a/pressed", Pressed)
    outside = []
    bench.world.transport.listen("/a/pressed", outside.append)
    out.publish(2)
    bench.world.drain()
    assert (numbers(plain), numbers(form), numbers(outside)) == ([1, 2], [-2], [-2])
    assert bench.press.encoded == 1
    assert (bench.port("out").messages, bench.port("out/pressed").messages) == (2, 1)


def test_an_in_port_receives_the_form_alone(bench):
    sub = bench.nh.Subscriber("in", Message, bench.got.append)
    bench.connect(**{"in": "/a"})
    assert bench.world.registrations == [("subscriber", "/a/pressed")]
    bench.send("/a", 1)
    bench.probe.Publisher("/b/pressed", Pressed).publish(-1)
    bench.world.transport.send("/a/pressed", Pressed(-2))
    bench.world.drain()
    assert numbers(bench.got) == [2] and type(bench.got[0]) is Message
    assert (sub.name, sub.data_class) == ("/a", Message)
    assert [(bench.port(p).messages, bench.port(p).topic) for p in ("in", "in/pressed")] == [
        (1, "/a"),
        (1, "/a/pressed"),
    ]


def test_a_companion_moves_with_its_port(bench):
    out = bench.nh.Publisher("out", Message, queue_size=1)
    bench.nh.Subscriber("in", Message, bench.got.append)
    maps = []
    bench.nh.set_reconfigure_callback(lambda *given: maps.append(given))
    for config, companion in (
        ({"out": "/moved"}, "/moved/pressed"),
        ({"out": ""}, ""),
        ({"out": "/back"}, "/back/pressed"),
        ({"out": "/again", "out/pressed": "/own"}, "/own"),
        ({"out": "/further"}, "/own"),
    ):
        bench.connect(**config)
        assert bench.topics()["out/pressed"] == companion
    bench.world.drain()
    assert maps[-1] == ({"in": ""}, {"out": "/further"})
    form = bench.listen("/own", Pressed)
    out.publish(3)
    bench.world.drain()
    assert numbers(form) == [-3]


def test_a_load_may_remap_a_companion_which_stays_there():
    given = {"out": "/a", "out/pressed": "/own", "~alone/pressed": "/here"}
    remappings = {"/ns/" + name.replace("~", "nodelet/"): given[name] for name in given}
    bench = PressedBench(remappings=remappings)
    bench.nh.Publisher("out", Message, queue_size=1)
    bench.nh.Subscriber("~alone", Message, bench.got.append)
    assert bench.topics() == {**given, "~alone": ""}
    assert sorted(bench.world.registrations) == [
        ("publisher", "/a"),
        ("publisher", "/own"),
        ("subscriber", "/here"),
    ]
    bench.connect(out="/moved")
    assert bench.topics() == {**given, "out": "/moved", "~alone": ""}


def test_a_switch_loses_and_doubles_nothing():
    world = World()
    sender, receiver = (PressedBench(world=world) for _ in range(2))
    out = sender.nh.Publisher("out", Message, queue_size=1)
    receiver.nh.Subscriber("in", Message, receiver.got.append)
    topics = ["/a", "/b"]
    for number in range(1, 101):
        topic = topics[number % 2]
        order = (sender, {"out": topic}), (receiver, {"in": topic})
        for bench, config in order if number % 3 else reversed(order):
            bench.connect(**config)
        out.publish(number)
    world.drain()
    assert numbers(receiver.got) == [*range(1, 101)]


def test_ports_have_parameters_of_their_own_before_those_of_the_nodelet():
    bench = PressedBench("cam/image", "depth")
    bench.nh.Publisher("cam/image", Message, queue_size=1)
    bench.nh.Subscriber("~depth", Message, print)
    bench.nh.Subscriber("words", Message, print)
    assert [*bench.topics()] == [
        "cam/image",
        "cam/image/pressed",
        "~depth",
        "~depth/pressed",
        "words",
    ]


def test_what_cannot_be_encoded_or_decoded_loses_that_message_of_that_form(bench, caplog):
    out = bench.nh.Publisher("out", Message, queue_size=1)
    bench.nh.Subscriber("in", Message, bench.got.append)
    bench.connect(out="/a", **{"in": "/b"})
    plain, form = bench.listen("/a"), bench.listen("/a/pressed", Pressed)
    for number in (1, 0, 2):
        out.publish(number)
        bench.world.transport.send("/b/pressed", Pressed(-number))
    bench.world.drain()
    assert (numbers(plain), numbers(form), numbers(bench.got)) == ([1, 0, 2], [-1, -2], [1, 2])
    assert (bench.port("out").dropped, bench.port("out/pressed").dropped) == (0, 1)
    assert bench.proxy.get_statistics().callback_errors == 2
    assert "'out/pressed' raised" in caplog.text and "nothing to press" in caplog.text
    assert "'in' raised" in caplog.text


def test_a_latched_form_is_there_for_later_subscribers(bench):
    out = bench.nh.Publisher("out", Message, latch=True, queue_size=1)
    bench.connect(out="/a")
    out.publish(4)
    assert numbers(bench.listen("/a/pressed", Pressed)) == []
    bench.world.drain()
    form = bench.listen("/a/pressed", Pressed)
    bench.connect(out="/b")
    bench.world.drain()
    assert numbers(form) == [-4]


def test_a_form_that_was_latched_while_disconnected_is_sent_at_the_connection(bench):
    out = bench.nh.Publisher("out", Message, latch=True, queue_size=1)
    out.publish(4)
    bench.connect(out="/a")
    plain, form = bench.listen("/a"), bench.listen("/a/pressed", Pressed)
    bench.world.drain()
    assert (numbers(plain), numbers(form)) == ([4], [-4])


def test_a_lazy_nodelet_sees_the_subscribers_of_both(bench):
    events = []

    class Listener:
        def peer_subscribe(self, topic, publish, publish_to):
            events.append(topic)
            publish_to(Message(len(events)))

        def peer_unsubscribe(self, topic, count):
            events.append(count)

    out = bench.nh.Publisher("out", Message, subscriber_listener=Listener(), queue_size=1)
    bench.connect(out="/a")
    form = bench.listen("/a/pressed", Pressed)
    bench.world.drain()
    plain = bench.listen("/a")
    bench.world.drain()
    assert (events, out.get_num_connections()) == (["/a", "/a"], 2)
    assert (numbers(plain), numbers(form)) == ([2], [-1])
    bench.connect(**{"out/pressed": ""})
    bench.world.drain()
    assert (events[2:], out.get_num_connections()) == ([1], 1)


@pytest.mark.parametrize(
    ("problem", "options", "published"),
    [
        (Denied, {"guards": lambda: Guards(denied_topics=("/*/pressed",))}, Message),
        (TypeMismatch, {}, OtherMessage),
    ],
)
def test_a_companion_that_cannot_follow_holds_its_port(problem, options, published):
    bench = PressedBench(world=World(**options))
    bench.nh.Subscriber("in", Message, print)
    if problem is TypeMismatch:
        bench.probe.Publisher("/a/pressed", published, queue_size=1)
    with pytest.raises(InvalidConfiguration) as caught:
        bench.connect(**{"in": "/a"})
    assert [type(each) for each in caught.value.problems] == [problem]
    assert bench.topics() == {"in": "", "in/pressed": ""}


def test_the_name_of_a_companion_is_taken(bench):
    bench.nh.Publisher("x", Message, queue_size=1)
    with pytest.raises(PortConflict, match="'x/pressed' exists as the companion"):
        bench.nh.Publisher("x/pressed", Pressed, queue_size=1)
    bench.nh.Publisher("y/pressed", OtherMessage, queue_size=1)
    with pytest.raises(PortConflict, match="'y/pressed' exists as out-port"):
        bench.nh.Publisher("y", Message, queue_size=1)
    assert "y" not in bench.topics()


def test_handles_share_a_companion_and_the_last_one_withdraws_it(bench):
    first, second = (bench.nh.Publisher("out", Message, queue_size=1) for _ in range(2))
    bench.connect(out="/a")
    form = bench.listen("/a/pressed", Pressed)
    first.unregister()
    second.publish(1)
    second.unregister()
    assert bench.world.registrations == [("subscriber", "/a/pressed")]
    third = bench.nh.Publisher("out", Message, queue_size=1)
    third.publish(2)
    bench.world.drain()
    assert numbers(form) == [-1, -2]
    assert bench.port("out/pressed").messages == 2
    bench.context.close()
    assert bench.world.registrations == [("subscriber", "/a/pressed")]


def test_a_fence_around_a_topic_of_a_claim_keeps_back_its_compressed_form():
    """Only one nodelet publishes on a topic of a claim, and on those below it."""
    fenced = {}
    clock = [0.0]
    leases = Leases(lambda topic: (), fenced.update, lambda: clock[0])
    begun = leases.renew("/manager", "uri", 0.0, 2.0, {"/claim": "/camera"})
    leases.renew("/manager", "uri", begun or 0.1, 2.0, {"/claim": "/camera"})
    assert [*fenced] == ["/claim/compressed", "/claim"]
    assert [fence("/camera") for fence in fenced.values()] == [True, True]
    clock[0] = 3.0
    assert [fence("/camera") for fence in fenced.values()] == [False, False]


def test_a_companion_that_moves_with_its_port_is_no_connection_of_its_own():
    """Another value of the parameter would take it from the nodelet, which is to come back."""
    ports = [
        PortState("cam/image", "out", "sensor_msgs/Image", "/a"),
        PortState("cam/image/compressed", "out", "sensor_msgs/CompressedImage", "/a/compressed"),
    ]
    moved = replace(ports[1], topic="/b")
    alone = PortState("compressed", "in", "", "/compressed")
    nodelet = NodeletStatus(
        "/n", "", "/m", False, False, False, State.RUNNING, "", (*ports, alone)
    )
    assert nodelet.connections == {"cam/image": "/a", "compressed": "/compressed"}
    assert moved_ports((ports[0], moved), NodeletKind.PYTHON) == (ports[0], moved)
    assert moved_ports((ports[1],), NodeletKind.PYTHON) == (ports[1],)
    assert moved_ports((*ports,), NodeletKind.CPP) == (*ports,)


def test_an_in_port_warns_once_of_a_topic_without_the_form(bench, caplog):
    bench.nh.Subscriber("in", Message, bench.got.append)
    bench.connect(**{"in": "/a"})

    def warnings():
        bench.world.ticker.advance(5.0)
        bench.world.runtime.timers.tick()
        bench.world.drain()
        return [record.getMessage() for record in caplog.records]

    assert warnings() == [], "nothing is published"
    plain = bench.probe.Publisher("/a", Message)
    (told,) = warnings()
    assert "/a is published, but /a/pressed is not; set image_transport of its publisher" in told
    plain.publish(1)
    assert warnings() == [told]
    bench.probe.Publisher("/b", Message)
    form = bench.probe.Publisher("/b/pressed", Pressed)
    bench.connect(**{"in": "/b"})
    form.publish(-1)
    bench.world.drain()  # it has come before the next look, which another thread takes
    assert warnings() == [told]
    form.unregister()
    assert len(warnings()) == 2


def test_a_handle_that_is_unregistered_looks_no_more(bench):
    kept = bench.nh.Subscriber("in", Message, print)
    for _ in range(3):
        bench.nh.Subscriber("in", Message, print).unregister()
    assert len(bench.world.runtime.timers._heap) == 1
    assert len(bench.context._strands) == 2, "the nodelet's own, and that of the timer"
    kept.unregister()
    kept.unregister()
    assert bench.world.runtime.timers._heap == []
