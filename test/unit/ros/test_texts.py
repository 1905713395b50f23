# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Texts of errors that leave the process, with characters or lengths that no message can have."""

from __future__ import annotations

import logging
from io import BytesIO
from types import SimpleNamespace
from typing import Any

import pytest
import rospy
from unit.proxy.bench import Bench

from dyknow.errors import LoadFailed
from dyknow.nodelet.texts import LONGEST, sendable
from dyknow.ros.nodelets import nodelet_manager
from dyknow.ros.nodelets.nodelet_log import NodeletLog
from dyknow.ros.transport.middleware import RospyServices
from dyknow.ros.wire.messages import counts_message

HALF = "unknown command \ud83d"


def sent(error: BaseException) -> str:
    """The text of an error, by way of rospy's encoding of it."""
    return bytes(str(error), "utf-8").decode()


def test_a_text_is_sendable() -> None:
    assert sendable(ValueError("5 °C")) == "5 °C"
    assert sendable(HALF) == "unknown command ?"
    assert sendable("x" * LONGEST) == "x" * LONGEST
    assert sendable("x" * 5_000_000) == "x" * (LONGEST - 1) + "…"


@pytest.mark.parametrize("text", [HALF, "x" * 5_000_000], ids=["half", "long"])
def test_an_error_of_a_callback_can_be_polled(text: str) -> None:
    bench = Bench()
    bench.context.failed("'in'", ValueError(text))
    buffer = BytesIO()
    counts_message("/n", bench.proxy.get_statistics(), 0.0).serialize(buffer)
    assert buffer.tell() < 3 * LONGEST


def test_a_load_that_fails_answers() -> None:
    error = LoadFailed("/n", "pack/Nodelet", ValueError(HALF))
    assert "unknown command ?" in sent(nodelet_manager._failed("Failed to load", "/n", error))


@pytest.mark.parametrize(
    "raised, expected",
    [
        (ValueError(HALF), "ValueError: unknown command ?"),
        (rospy.ServiceException(HALF), "unknown command ?"),
        (ValueError("5 °C"), "5 °C"),
    ],
)
def test_a_handler_that_raises_answers(monkeypatch: Any, raised: Exception, expected: str) -> None:
    offered: list[Any] = []
    monkeypatch.setattr(rospy, "Service", lambda *args, **options: offered.append(args[2]))

    def handler(request: Any) -> Any:
        raise raised

    RospyServices().offer("/n/act", object, handler, {})
    with pytest.raises(Exception, match="") as caught:
        offered[0](None)
    assert sent(caught.value) == expected
    is_service_error = isinstance(raised, rospy.ServiceException)
    assert isinstance(caught.value, rospy.ServiceException) is is_service_error
    assert raised in (caught.value, caught.value.__cause__)


def test_a_line_of_the_log() -> None:
    line = logging.makeLogRecord({"msg": "raised %s", "args": (HALF,)})
    assert NodeletLog(lambda name: None).format(line) == "raised unknown command ?"


def test_an_error_of_a_callback_is_logged_in_the_name_of_its_nodelet(
    caplog: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []
    publisher = SimpleNamespace(publish=sent.append)
    monkeypatch.setattr(rospy.impl.rosout, "_rosout_pub", publisher)
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    context = Bench().context
    context.failed("'in'", ValueError(HALF))
    assert "unknown command ?" in caplog.text
    topics = {context.name: ["/in"]}
    NodeletLog(topics.get).emit(caplog.records[-1])
    assert [(line.name, line.topics) for line in sent] == [(context.name, ["/in"])]
