"""The topic that `dyknow connect` chooses."""

from __future__ import annotations

import pytest

pytest.importorskip("rospy")

from dyknow.cli.connecting import PortReference, choose_topic
from dyknow.manager.model import PortState


@pytest.mark.parametrize(
    ("out", "into", "is_fed", "topic"),
    [
        ("/a", "/b", True, "/a"),
        ("", "/b", False, "/b"),
        ("", "/b", True, "/one/out"),
        ("", "", False, "/one/out"),
    ],
)
def test_the_in_port_hears_the_out_port_and_only_that(
    out: str, into: str, is_fed: bool, topic: str
) -> None:
    source = PortReference("/one", "out")
    chosen = choose_topic(
        source, PortState("out", "out", topic=out), PortState("in", "in", topic=into), is_fed
    )
    assert chosen == topic
