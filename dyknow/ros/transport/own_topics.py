# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tells the topics of the code in a process from DyKnow's own ones.

rospy lists all topics of the process in every message to /rosout and in the slave API. A program
that runs unchanged lists those that it uses itself. Guards bind the code in a process.
"""

from __future__ import annotations

from typing import Any, Callable, Collection, List

from rospy.impl.registration import get_topic_manager

#: Packages of messages that the process sends for itself.
_OWN = ("bond/", "dyknow_msgs/", "rosgraph_msgs/")


def guard_topics(check_topic: Callable[[str], None]) -> None:
    """Check each topic before rospy registers it, for code that uses rospy itself.

    The hook is one instance attribute of rospy's topic manager.

    Args:
        check_topic: raises Denied if nothing must be connected to the topic.
    """
    manager = get_topic_manager()
    acquire = manager.acquire_impl

    def acquire_checked(side: str, topic: str, datatype: Any) -> Any:
        if not datatype._type.startswith(_OWN):
            check_topic(topic)
        return acquire(side, topic, datatype)

    manager.acquire_impl = acquire_checked


def hide_topics(hidden: Collection[str]) -> None:
    """Leave topics out of this process's lists of topics; they work as before.

    The hook is three instance attributes of rospy's topic manager.

    Args:
        hidden: global names.
    """
    manager = get_topic_manager()
    publications, subscriptions = manager.get_publications, manager.get_subscriptions
    topics = manager.get_topics

    def shown(listed: Collection[Any]) -> List[Any]:
        return [each for each in listed if each[0] not in hidden]

    manager.get_topics = lambda: topics().difference(hidden)
    manager.get_publications = lambda: shown(publications())
    manager.get_subscriptions = lambda: shown(subscriptions())
