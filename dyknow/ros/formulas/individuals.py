# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The individuals of a quantifier: the bindings of a tag, whose streams are acquired."""

from __future__ import annotations

import time
from typing import Any, Callable, Iterator, Mapping

import rospy

from dyknow.backoff import Backoff
from dyknow.errors import BadParameter, DyKnowError
from dyknow.formulas import Formula, Monitor, Verdict
from dyknow.locks import state_lock
from dyknow.manager.specifications.tags import parse_tag, tag_of_individuals
from dyknow.model.streams import ClaimState
from dyknow.periodic import PeriodicWorker
from dyknow.ros.acquiring import AcquiredStream, acquire
from dyknow.ros.client import ManagerClient
from dyknow.ros.formulas.message_types import known_class

#: Seconds between two looks for individuals that have come or gone.
_PERIOD = 1.0
#: The states of a stream whose individual is present; one that is in trouble is judged by it.
_PRESENT = (ClaimState.ACTIVE, ClaimState.DEGRADED, ClaimState.RECOVERING)

Subscribe = Callable[[str, str, str, Any], Any]
"""Subscribes a port, for an individual, to a topic of a class; the answer has ``unregister``."""


def tags_of_individuals(formula: Formula, tags: Mapping[str, str]) -> dict[str, str]:
    """Return the tag of each port below a quantifier, with the quantifier's concept.

    Raises:
        DyKnowError: a port has no tag, one that does not fit, or stands below no quantifier.
        FormulaError: see ``Formula.ranges``.
    """
    wanted = formula.ranges()
    for port in sorted(wanted.keys() - tags.keys()):
        raise DyKnowError(
            f"the port '{port}' has a stream for each {wanted[port].variable}: expected its tag, "
            f"such as Image({wanted[port].variable})"
        )
    for port in sorted(tags.keys() - wanted.keys()):
        raise DyKnowError(f"the port '{port}' stands below no quantifier: expected no tag")
    return {
        port: str(tag_of_individuals(port, parse_tag(tags[port]), range_))
        for port, range_ in wanted.items()
    }


def take_waiting(
    monitor: Monitor,
    waiting: dict[tuple[str, str], Any],
    present: Mapping[str, list[str]],
    now: Any,
) -> Iterator[Verdict]:
    """Yield the verdicts that present individuals, and the messages that wait for them, decide.

    ``waiting`` has the last message of each port, of an individual, all of them received ``now``;
    those that the monitor hears are taken.
    """
    for variable, names in present.items():
        yield from monitor.individuals(variable, names, now)
    for port, individual in list(waiting):
        if monitor.hears(port, individual):
            yield from monitor.feed(port, waiting.pop((port, individual)), now, individual)


class IndividualStreams:
    """Acquires the streams of all individuals, on a thread of its own: that may take a while."""

    def __init__(
        self,
        client: ManagerClient,
        tags: Mapping[str, str],
        classes: Mapping[str, Any],
        subscribe: Subscribe,
        client_id: str = "",
    ) -> None:
        """Start to look for individuals.

        Each port has a tag with one variable; a stream of one without a message class may have any
        type. By default the client's name is this node's.

        Raises:
            BadParameter: a tag has no variable, or several.
            InvalidTag: a tag is not a term.
        """
        self._terms = {port: parse_tag(tag) for port, tag in tags.items()}
        for port, term in self._terms.items():
            if len(term.variables) != 1:
                raise BadParameter(port, tags[port], "a tag with one variable, the quantifier's")
        self._client = client
        self._classes = classes
        self._subscribe = subscribe
        self._client_id = client_id
        #: The streams, and their subscribers; None for one that cannot be made yet.
        self._streams: dict[tuple[str, str], tuple[AcquiredStream, Any | None]] = {}
        self._closed = False
        self._state_lock = state_lock("individuals of a formula")
        #: Tags of streams that are of no use here: to acquire one may spawn nodelets.
        self._useless = Backoff(time.monotonic, first=_PERIOD, tolerated=0)
        #: Tags whose individuals have no stream, as the log says.
        self._told: set[str] = set()
        #: Whether it has looked for individuals once.
        self.is_known = False
        self._worker = PeriodicWorker("individuals of a formula", self._look, _PERIOD)
        self._worker.start()

    def close(self) -> None:
        """Release all streams; one that is being acquired is released as soon as it is there."""
        self._worker.close()
        with self._state_lock:
            self._closed = True
        for key in list(self._streams):
            self._remove(key)

    def present(self) -> dict[str, list[str]] | None:
        """Return the individuals of each variable that have a stream at each of its ports.

        None before the first look for them.
        """
        if not self.is_known:
            return None
        found: dict[str, set[str]] = {}
        for port, term in self._terms.items():
            (variable,) = term.variables
            names = {
                name
                for (of_port, name), (stream, subscriber) in list(self._streams.items())
                if of_port == port and subscriber is not None and stream.state in _PRESENT
            }
            found[variable] = found.get(variable, names) & names
        return {variable: sorted(names) for variable, names in found.items()}

    def _look(self) -> None:
        for key, (stream, _) in list(self._streams.items()):
            if stream.state.ended:  # released by hand, say, or the manager began anew
                self._remove(key)
        for port, term in self._terms.items():
            kind = self._classes.get(port)
            bindings = self._client.find_bindings(str(term), "" if kind is None else kind._type)
            names = {each.partition("=")[2] for each in bindings}
            here = {name for of_port, name in list(self._streams) if of_port == port}
            for name in sorted(here - names):
                self._remove((port, name))
            for name in sorted(names):
                self._try_to_add(port, name, str(term.substitute({term.variables[0]: name})))
        self.is_known = True

    def _try_to_add(self, port: str, name: str, tag: str) -> None:
        stream, subscriber = self._streams.get((port, name), (None, None))
        if subscriber is not None or self._closed or not self._useless.allows(tag):
            return
        try:
            why = self._add(port, name, tag, stream)
        except DyKnowError as error:
            self._useless.failed(tag)
            why = str(error)
        if why and tag not in self._told:
            rospy.logwarn("the individual %s has no stream %s: %s", name, tag, why)
        (self._told.add if why else self._told.discard)(tag)

    def _add(self, port: str, name: str, tag: str, known: AcquiredStream | None) -> str:
        """Acquire a stream that is not known, and subscribe to it; say why it cannot be made."""
        kind = self._classes.get(port, "")
        # One that a verdict forbids is pending: the verdict is heard as long as a claim needs it.
        stream = known or acquire(
            tag, kind, pending=True, client_id=self._client_id, manager=self._client.manager
        )
        subscriber = None
        try:
            if stream.topic:
                kind = kind or known_class(stream.datatype)
                subscriber = self._subscribe(port, name, stream.topic, kind)
        except BaseException:
            self._streams.pop((port, name), None)
            stream.release()
            raise
        with self._state_lock:
            if not self._closed:
                self._streams[port, name] = stream, subscriber
                return "" if subscriber is not None else stream.detail
        if subscriber is not None:
            subscriber.unregister()
        stream.release()
        return ""

    def _remove(self, key: tuple[str, str]) -> None:
        with self._state_lock:
            found = self._streams.pop(key, None)
        if found is not None:
            stream, subscriber = found
            if subscriber is not None:
                subscriber.unregister()
            stream.release()
