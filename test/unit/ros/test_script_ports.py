# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ports of scripts that make their subscribers late."""

from __future__ import annotations

import pytest
from unit.nodelet.fakes import Message, World, numbers

from dyknow.errors import InvalidConfiguration
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.ros.scripts.script_ports import ScriptHandle, ScriptProxy


class Script:
    """A script whose load names the topic `image`."""

    def __init__(self):
        self.world = World()
        remappings = {"/robot/image": "/robot/script/disconnected/image"}
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
