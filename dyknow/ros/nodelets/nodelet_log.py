# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Lines of nodelets on ``/rosout`` bear the nodelet's name instead of that of its process."""

from __future__ import annotations

import logging
import threading
from typing import Callable

import rospy
import rospy.impl.rosout
from rosgraph_msgs.msg import Log

from dyknow.nodelet.texts import encodable

#: rospy's logger, below which each nodelet has its own.
_ROOT = "rosout."


class NodeletLog(rospy.impl.rosout.RosOutHandler):
    """Takes the place of rospy's handler; ``topics`` lists the topics of a nodelet, or is None."""

    def __init__(self, topics: Callable[[str], list[str] | None]) -> None:
        super().__init__()
        self._topics = topics
        self._thread = threading.local()

    @classmethod
    def install(cls, topics: Callable[[str], list[str] | None]) -> None:
        """Put it in the place of rospy's handlers."""
        logger = logging.getLogger(_ROOT[:-1])
        for handler in list(logger.handlers):
            if type(handler) is rospy.impl.rosout.RosOutHandler:
                made = cls(topics)
                made.setFormatter(handler.formatter)
                made.setLevel(handler.level)
                logger.addHandler(made)
                logger.removeHandler(handler)

    def format(self, record: logging.LogRecord) -> str:
        """Return a line that can be sent, also of a text with half of a surrogate pair."""
        return encodable(super().format(record))

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a line; those of the process itself as rospy does."""
        logger = "/" + record.name[len(_ROOT) :].replace(".", "/")
        name = getattr(record, "nodelet", logger)
        topics = self._topics(name)
        publisher = rospy.impl.rosout._rosout_pub
        if topics is None or publisher is None:
            super().emit(record)
            return
        if getattr(self._thread, "is_inside", False):
            return  # publishing logs something
        self._thread.is_inside = True
        try:
            line = Log(
                level=rospy.impl.rosout._logging_to_rospy_levels[record.levelno],
                name=name,
                msg=self.format(record),
                topics=topics,
                file=record.filename,
                line=record.lineno,
                function=record.funcName,
            )
            line.header.stamp = rospy.Time.now()
            publisher.publish(line)
        except Exception:  # the boundary of logging
            self.handleError(record)
        finally:
            self._thread.is_inside = False
