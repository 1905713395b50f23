# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports of scripts that make their subscribers late."""

from __future__ import annotations

import pytest
from rospy import SubscribeListener
from unit.nodelet.fakes import AnyMessage, Message, OtherMessage, World, numbers

from dyknow.errors import InvalidConfiguration, PortConflict
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.handle import NodeHandle
from dyknow.ros.scripts.script_ports import ScriptHandle, ScriptProxy


class Script:
    """A script whose load names the topic `image`."""

    def __init__(self, **others):
        self.world = World()
        remappings = {"/robot/image": "/robot/script/disconnected/image", **others}
        context = self.world.context("/robot/script", remappings=remappings)
        self.handle = ScriptHandle(PlainNodeHandle(context, "/robot"))
        self.proxy = ScriptProxy.of(context)
        self.handle.Publisher("out", Message)

    def ports(self):
        return {port.name: (port.datatype, port.topic) for port in self.proxy.get_config()}


@pytest.fixture(name="script")
def _script():
    return Script()


def test_a_port_to_come_is_connected_when_it_comes(script):
    assert script.ports() == {"out": ("test/Message", "/robot/out")}
    script.proxy.set_config([("image", "/cam")])
    assert script.ports()["image"] == ("", "/cam")
    script.proxy.set_config([("/robot/image", "/cam2")])
    got = []
    script.handle.Subscriber("image", Message, got.append)
    assert script.ports()["image"] == ("test/Message", "/cam2")
    script.world.handle().Publisher("/cam2", Message).publish(1)
    script.world.drain()
    assert numbers(got) == [1]


def test_it_may_turn_out_to_be_an_out_port(script):
    script.proxy.set_config([("image", "/cam")])
    script.handle.Publisher("image", Message)
    assert script.ports()["image"] == ("test/Message", "/cam")
    script.handle.Subscriber("image", Message, print)
    assert sorted(script.ports()) == ["image_in", "image_out", "out"]
    for name in ("image", "/robot/image"):
        with pytest.raises(InvalidConfiguration, match="known ports: image_in, image_out, out"):
            script.proxy.set_config([(name, "/cam")])


@pytest.mark.parametrize("name", ["imag", "/image", "a b", "~image", ""])
def test_what_no_load_names_is_unknown(script, name):
    with pytest.raises(InvalidConfiguration, match="unknown port"):
        script.proxy.set_config([(name, "/cam")])
    assert list(script.ports()) == ["out"]


@pytest.mark.parametrize("kind", [NodeHandle, ScriptHandle])
@pytest.mark.parametrize(
    ("port", "near"),
    [
        ("imge", "image"),
        ("~image", "image"),
        ("info", "~info"),
        ("/info", "~info"),
        ("image_", "image"),
        ("cam/imge", "cam/image"),
    ],
)
def test_a_misspelt_port_is_refused_with_the_right_one(kind, port: str, near: str) -> None:
    """In nodelets, and in scripts in a nodelet manager or in a process of their own."""
    context = World().context("/robot/n", remappings={"/robot/image": "/x"})
    handle = kind(PlainNodeHandle(context, "/robot"))
    for name in ("image", "cam/image"):
        handle.Subscriber(name, Message, print)
    handle.Publisher("~info", Message)
    proxy = kind.proxy_class.of(context)
    before = proxy.get_config()
    with pytest.raises(InvalidConfiguration) as error:
        proxy.set_config([("image", "/y"), (port, "/z")])
    assert f"unknown port '{port}'; known ports: cam/image, image, ~info; " in str(error.value)
    hints = str(error.value).split("did you mean ")[1].rstrip("?").split(" or ")
    assert near in hints
    assert proxy.get_config() == before


@pytest.mark.parametrize("maker", ["Publisher", "Subscriber"])
def test_what_the_load_misspells_is_unknown(script, maker):
    getattr(script.handle, maker)("~image", Message, None)
    with pytest.raises(InvalidConfiguration, match="did you mean ~image"):
        script.proxy.set_config([("image", "/cam")])
    assert sorted(script.ports()) == ["out", "~image"]


def test_a_lazy_script_may_have_both():
    """Either its load names both, or it watches its subscribers."""
    named = Script(**{"/robot/script/image": "/x"})
    named.handle.Publisher("~image", Message)
    watching = Script()
    watching.handle.Publisher("~image", Message, subscriber_listener=SubscribeListener())
    for script in (named, watching):
        script.proxy.set_config([("image", "/cam")])
        assert script.ports()["image"] == ("", "/cam")


def test_a_port_by_a_longer_name(script):
    script.handle.Publisher("~out", Message)
    script.proxy.set_config([("script/out", "/x")])
    assert script.ports()["~out"] == ("test/Message", "/x")
    assert "script/out" not in script.ports()


@pytest.mark.parametrize("maker", ["Publisher", "Subscriber"])
def test_a_port_that_the_script_has_let_go_of_may_get_another_type(script, maker):
    make = getattr(script.handle, maker)
    make("words", OtherMessage, None).unregister()
    make("words", Message, None)
    assert script.ports()["words"] == ("test/Message", "/robot/words")
    with pytest.raises(PortConflict, match="a port of type test/OtherMessage"):
        make("words", OtherMessage, None)


def test_a_subscriber_to_any_type_goes_with_one_of_a_type(script):
    got, any_type = [], []
    for datatype, received in ((AnyMessage, any_type), (Message, got), (AnyMessage, any_type)):
        script.handle.Subscriber("words", datatype, received.append)
    assert script.ports()["words"] == ("test/Message", "/robot/words")
    script.world.handle().Publisher("/robot/words", Message).publish(1)
    script.world.drain()
    assert numbers(got) == [1]
