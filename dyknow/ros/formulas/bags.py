# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages of bags, for one monitor."""

from __future__ import annotations

import contextlib
from typing import Any, Callable, Iterator, Mapping

import rosbag

from dyknow.errors import DyKnowError
from dyknow.formulas import Monitor, Verdict
from dyknow.ros.wire.message_classes import message_class
from dyknow.similar import did_you_mean


@contextlib.contextmanager
def bag_errors(path: str) -> Iterator[None]:
    """Raise DyKnowError for a bag that cannot be read in the block."""
    try:
        yield
    except rosbag.ROSBagUnindexedException as error:
        hint = f"'rosbag reindex {path}' makes one"
        raise DyKnowError(f"bag '{path}' cannot be read: it has no index; {hint}") from error
    except (OSError, rosbag.ROSBagException) as error:
        why = getattr(error, "strerror", None) or error
        raise DyKnowError(f"bag '{path}' cannot be read: {why}") from error
    except Exception as error:  # the boundary: rosbag does not check what it reads
        problem = f"{type(error).__name__}: {error}"
        raise DyKnowError(f"bag '{path}' is damaged, or is no bag ({problem})") from error


class Bag:
    """The messages of a bag."""

    def __init__(self, path: str) -> None:
        """Open a bag.

        Raises:
            DyKnowError: it cannot be read.
        """
        with bag_errors(path):
            self._bag = rosbag.Bag(path)
            self._sums, found = self._bag.get_type_and_topic_info()
        #: The topics, with their types.
        self.datatypes = {topic: each.msg_type for topic, each in sorted(found.items())}
        self._path = path

    def has_built(self, datatype: str) -> bool:
        """Whether a message type is the one that is built here, not an earlier one of its name."""
        return bool(self._sums[datatype] == getattr(message_class(datatype), "_md5sum", ""))

    def topic(self, port: str, given: Mapping[str, str]) -> str:
        """Return the topic of a port: the one that is given, or the one of its name.

        Raises:
            DyKnowError: the bag does not have it.
        """
        topic = given.get(port, f"/{port}")
        if topic in self.datatypes:
            return topic
        known = ", ".join(self.datatypes) or "none"
        hint = did_you_mean(topic, self.datatypes) or f"; it has {known}"
        raise DyKnowError(f"bag '{self._path}' has no topic '{topic}' for the port '{port}'{hint}")

    def verdicts(
        self, monitor: Monitor, topics: Mapping[str, str], progress: Callable[[float], object]
    ) -> Iterator[Verdict]:
        """Yield the verdicts about all of it, with the topic of each port.

        ``progress`` is called with the seconds of the bag that are done.
        """
        ports: dict[str, list[str]] = {}
        for port, topic in topics.items():
            ports.setdefault(topic, []).append(port)
        begin = self._bag.get_start_time()
        for topic, message, when in self._read(list(ports)):
            for port in ports[topic]:
                yield from monitor.feed(port, message, when)
            progress(when.to_sec() - begin)
        yield from monitor.finish()

    def _read(self, topics: list[str]) -> Iterator[Any]:
        with bag_errors(self._path):
            yield from self._bag.read_messages(topics=topics)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last message."""
        return float(self._bag.get_end_time() - self._bag.get_start_time())
