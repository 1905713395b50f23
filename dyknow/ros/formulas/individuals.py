# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The individuals of a quantifier: the bindings of a tag, whose streams are acquired."""

from __future__ import annotations

from typing import Any, Callable, Mapping

import rospy

from dyknow.errors import BadParameter, DyKnowError
from dyknow.formulas import Formula
from dyknow.manager.specifications.individual_tags import tag_of_individuals
from dyknow.manager.specifications.tags import Term, parse_tag
from dyknow.periodic import PeriodicWorker
from dyknow.ros.acquiring import AcquiredStream, acquire
from dyknow.ros.client import ManagerClient
from dyknow.ros.formulas.message_types import known_class

#: Seconds between two looks for individuals that have come or gone.
_PERIOD = 1.0

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

        Args:
            client: of the manager.
            tags: a tag with one variable for each port.
            classes: message classes of ports; a stream of one without may have any type.
            subscribe: receives the streams.
            client_id: name of the client; by default this node's.

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
        self._streams: dict[tuple[str, str], tuple[AcquiredStream, Any]] = {}
        #: Whether it has looked for individuals once.
        self.is_known = False
        self._worker = PeriodicWorker("individuals of a formula", self._look, _PERIOD)
        self._worker.start()

    def close(self) -> None:
        """Release all streams."""
        self._worker.close()
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
            names = {name for of_port, name in list(self._streams) if of_port == port}
            found[variable] = found.get(variable, names) & names
        return {variable: sorted(names) for variable, names in found.items()}

    def _look(self) -> None:
        for port, term in self._terms.items():
            kind = self._classes.get(port)
            bindings = self._client.find_bindings(str(term), "" if kind is None else kind._type)
            names = {each.partition("=")[2] for each in bindings}
            here = {name for of_port, name in self._streams if of_port == port}
            for name in sorted(names - here):
                self._add(port, name, term)
            for name in sorted(here - names):
                self._remove((port, name))
        self.is_known = True

    def _add(self, port: str, name: str, term: Term) -> None:
        tag, kind = str(term.substitute({term.variables[0]: name})), self._classes.get(port, "")
        try:
            stream = acquire(tag, kind, client_id=self._client_id, manager=self._client.manager)
        except DyKnowError as error:
            rospy.logwarn_throttle(60, f"the individual {name} has no stream {tag}: {error}")
            return
        kind = kind or known_class(stream.datatype)
        self._streams[port, name] = stream, self._subscribe(port, name, stream.topic, kind)

    def _remove(self, key: tuple[str, str]) -> None:
        stream, subscriber = self._streams.pop(key)
        subscriber.unregister()
        stream.release()
