"""Conversion between DyKnow's values and the messages of dyknow_msgs."""

from __future__ import annotations

from typing import List, Sequence, Tuple

import rospy
from dyknow_msgs.msg import NodeletCounts, Port, PortCount, PortStatistics
from dyknow_msgs.msg import PortConfig as PortConfigMessage
from dyknow_msgs.srv import GetStatisticsResponse

from dyknow.proxy.port import OUT, PortConfig
from dyknow.proxy.proxy import NodeletProxy, ProxyStatistics


def _direction(port: PortConfig) -> int:
    return int(Port.OUT if port.direction == OUT else Port.IN)


def port_messages(ports: Sequence[PortConfig]) -> List[Port]:
    """Ports of a running nodelet; tags are the specification's to tell."""
    return [Port(port.name, _direction(port), port.datatype, port.topic, []) for port in ports]


def config_pairs(config: Sequence[PortConfigMessage]) -> List[Tuple[str, str]]:
    """Pairs of port and topic."""
    return [(entry.port, entry.topic) for entry in config]


def counts_message(proxy: NodeletProxy) -> NodeletCounts:
    """A nodelet's part of the answer of ``get_counts``."""
    statistics = proxy.get_statistics()
    return NodeletCounts(
        nodelet=proxy.name,
        uptime=rospy.Duration.from_sec(statistics.uptime),
        ports=[
            PortCount(
                port=each.port.name,
                direction=_direction(each.port),
                messages=each.traffic.messages,
                latched=each.latched,
            )
            for each in sorted(statistics.ports, key=lambda each: each.port.name)
        ],
    )


def statistics_message(statistics: ProxyStatistics) -> GetStatisticsResponse:
    """Answer of ``get_statistics``."""
    return GetStatisticsResponse(
        uptime=rospy.Duration.from_sec(statistics.uptime),
        reconfigurations=statistics.reconfigurations,
        callback_errors=statistics.callback_errors,
        ports=[
            PortStatistics(
                port=each.port.name,
                direction=_direction(each.port),
                topic=each.port.topic,
                messages=each.traffic.messages,
                dropped=each.traffic.dropped,
                rate=each.traffic.rate,
                mean_callback=rospy.Duration.from_sec(each.traffic.mean_callback),
                max_callback=rospy.Duration.from_sec(each.traffic.max_callback),
            )
            for each in statistics.ports
        ],
    )
