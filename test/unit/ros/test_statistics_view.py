"""What `get_statistics` answers, read as values: unknown is not zero."""

from __future__ import annotations

import math

from dyknow_msgs.msg import PortStatistics
from dyknow_msgs.srv import GetStatisticsResponse

from dyknow.ros.views import PortTraffic, statistics_view


def _answer(**port):
    return GetStatisticsResponse(
        reconfigurations=2, callback_errors=3, ports=[PortStatistics(port="p", **port)]
    )


def test_what_is_counted():
    view = statistics_view(_answer(direction=1, topic="/t", messages=4, dropped=5, rate=0.0))
    assert (view.reconfigurations, view.callback_errors) == (2, 3)
    assert view.ports == (PortTraffic("p", "out", "/t", 4, 5, 0.0, 0.0, 0.0),)


def test_what_nobody_counts():
    view = statistics_view(_answer(topic="/t", rate=math.nan))
    assert (view.reconfigurations, view.callback_errors) == (2, None)
    assert view.ports == (PortTraffic("p", "in", "/t", None, None, None, None, None),)
