# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps DyKnow's own topics out of what a node reports of itself.

rospy lists all topics of the process in every message to /rosout and in the slave API. A program
that runs unchanged lists those that it uses itself.
"""

from __future__ import annotations

from typing import Any, Collection, List

from rospy.impl.registration import get_topic_manager


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
