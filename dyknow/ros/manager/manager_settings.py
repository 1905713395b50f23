# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Private parameters of the node dyknow_manager."""

from __future__ import annotations

import contextlib
import os
import re
from dataclasses import dataclass, fields
from typing import Any, Iterator, Sequence

import rosgraph
import rospkg
import rospy

from dyknow import names
from dyknow.guards import NO_GUARDS, Guards
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.supervision.watchdog import NO_WATCHDOG, WatchdogLimits
from dyknow.ros.manager import tenure
from dyknow.ros.parameters import PrivateParameters
from dyknow.ros.process.os_process import only_for_owner
from dyknow.similar import did_you_mean

#: Seconds by which the clock of another host may differ without a warning.
MAX_CLOCK_OFFSET = 0.1
#: Most seconds of a parameter, and of one that limits an answer of a socket.
_MOST_SECONDS, _MOST_PATIENCE = 1e9, 1e6
#: Ending of the file with the name of the node that has the files of the state.
_BEARER = "node"
_GUARDS = ("string_length", "array_length", "nodelets")
_SIZES = ("text_size", "transformations")

#: Parameters that are namespaces, with the parameters in them.
GROUPS = {"watchdog": ("hung", "stuck", "memory"), "limits": (*_GUARDS, *_SIZES)}


@dataclass(frozen=True)
class ManagerSettings:
    """Values of the parameters.

    Attributes:
        nodelet_managers: global names of external nodelet managers to use as well.
        num_nodelet_managers: number of its own nodelet managers.
        state_dir: folder of the durable state; empty for the default.
        ontologies: files with the concepts of templates and tags.
        catalogues: files with the places of imported ontologies.
        language: preferred language of labels that become names.
        transformations: files of specifications, which are followed.
        wiring: file to load at the start; empty for none.
        keep: whether its nodelets and claims outlive an end on purpose.
        use_exports: whether the files that packages export are used too.
        spawn_timeout: seconds that a nodelet may take to come up.
        orphan_timeout: seconds for which its nodelet managers outlive it; 0 for ever.
        recover: seconds of TRUE verdicts after a FALSE one, until parts that require it are used.
        max_clock_offset: seconds by which the clock of another host may differ without a warning.
        shared_memory: whether its processes exchange large messages through shared memory.
        watchdog: when its processes are restarted.
        spread: whether nodelets that compute much are moved apart.
        spread_load: cores that the nodelets of a nodelet manager may take before that.
        guards: restrictions.
        limits: sizes of specifications.
    """

    nodelet_managers: tuple[str, ...] = ()
    num_nodelet_managers: int = 1
    state_dir: str = ""
    ontologies: tuple[str, ...] = ()
    catalogues: tuple[str, ...] = ()
    language: str = "en"
    transformations: tuple[str, ...] = ()
    use_exports: bool = True
    wiring: str = ""
    keep: bool = False
    spawn_timeout: float = 10.0
    orphan_timeout: float = 300.0
    recover: float = 2.0
    max_clock_offset: float = MAX_CLOCK_OFFSET
    shared_memory: bool = True
    watchdog: WatchdogLimits = NO_WATCHDOG
    spread: bool = False
    spread_load: float = 0.7
    guards: Guards = NO_GUARDS
    limits: SpecificationLimits = DEFAULT_LIMITS

    @classmethod
    def read(cls, parameters: Any) -> ManagerSettings:
        """Read the node's private parameters; BadParameter if one has an unusable value."""
        given = _Parameters(parameters)
        given.check_groups()
        given.warn_of_unknown()
        return cls(
            nodelet_managers=given.nodes("nodelet_managers", rospy.get_name()),
            num_nodelet_managers=given.integer("num_nodelet_managers", 1),
            state_dir=given.path("state_dir"),
            ontologies=given.paths("ontologies"),
            catalogues=given.paths("catalogues"),
            language=given.string("language", cls.language),
            transformations=given.paths("transformations"),
            wiring=given.path("wiring"),
            keep=given.flag("keep"),
            use_exports=given.flag("use_exports", cls.use_exports),
            spawn_timeout=given.seconds("spawn_timeout", cls.spawn_timeout, 0.001, _MOST_PATIENCE),
            orphan_timeout=given.seconds("orphan_timeout", cls.orphan_timeout, least=0.0),
            recover=given.seconds("recover", cls.recover, least=0.0),
            max_clock_offset=given.seconds("max_clock_offset", cls.max_clock_offset, least=0.0),
            shared_memory=given.flag("shared_memory", cls.shared_memory),
            watchdog=WatchdogLimits(
                given.seconds("watchdog/hung", 0.0, least=0.0),
                given.seconds("watchdog/stuck", 0.0, least=0.0),
                given.number("watchdog/memory", 0.0, "MB, at least 0", lambda value: value >= 0),
            ),
            spread=given.one_of("spread", "", "auto") == "auto",
            spread_load=given.number(
                "spread_load", cls.spread_load, "cores, at least 0.01", lambda value: value >= 0.01
            ),
            guards=Guards(
                denied_topics=given.topic_patterns("denied_topics"),
                allowed_topics=tuple(filter(None, [given.topic_patterns("allowed_topics")])),
                allowed_programs=tuple(filter(None, [given.strings("allowed_programs")])),
                remote_programs=given.flag("remote_programs", True),
                read_only=given.flag("read_only"),
                **given.limits(Guards, *_GUARDS),
            ),
            limits=SpecificationLimits(**given.limits(SpecificationLimits, *_SIZES)),
        )

    def state_path(self, ending: str) -> str:
        """Return a file of the durable state, of which each master and node name has its own."""
        return state_path(self.state_dir, rosgraph.get_master_uri(), rospy.get_name(), ending)

    def take_state(self) -> None:
        """Note that the files of the state are this node's."""
        path = self.state_path(_BEARER)
        with contextlib.suppress(OSError):  # it is noted, or cannot be written
            os.makedirs(os.path.dirname(path), 0o700, exist_ok=True)
            with open(path, "x", encoding="utf-8", opener=only_for_owner) as file:
                file.write(rospy.get_name())


#: The private parameters that a DyKnow manager reads; guards are read one by one.
PARAMETERS = (
    *(each.name for each in fields(ManagerSettings) if each.name != "guards"),
    *("denied_topics", "allowed_topics", "allowed_programs", "remote_programs", "read_only"),
)


def mirror_path() -> str:
    """Return the file with the mirror of the master, which is used before the parameters are."""
    folder = PrivateParameters({"state_dir": rospy.get_param("~state_dir", "")})
    return state_path(
        folder.string("state_dir"), rosgraph.get_master_uri(), rospy.get_name(), "master"
    )


def state_path(folder: str, master: str, node: str, ending: str) -> str:
    """Return a file of the durable state of a DyKnow manager.

    Names that differ in ``_`` and ``/`` alone have the same key. The node that came first has its
    files, and the others have files of their own. An empty ``folder``, the value of ~state_dir, is
    the default below ROS_HOME.
    """
    folder = os.path.expanduser(folder or os.path.join(rospkg.get_ros_home(), "dyknow"))
    host, port = rosgraph.network.parse_http_host_and_port(master)
    place = os.path.join(folder, _plain(f"{host}-{port}"))
    shared, own = place + _plain(node), place + node.replace("/", "+")
    has_own = os.path.exists(f"{own}.{_BEARER}") or _bearer(shared) not in ("", node)
    return f"{own if has_own else shared}.{ending}"


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text)


def _bearer(key: str) -> str:
    """Return the node that has the files of a key; empty if that is not noted."""
    try:
        with open(f"{key}.{_BEARER}", encoding="utf-8", errors="replace") as file:
            name = file.read()
    except OSError:
        return ""
    return name if name.startswith("/") else ""  # the power failed while it was written


def unknown_parameters(given: Any) -> list[tuple[str, str]]:
    """List the parameters in a node's namespace that the manager ignores, with suggestions."""
    return [
        (name, did_you_mean(name, known, at_most=1, prefix="~")) for name, known in _unknown(given)
    ]


def _unknown(given: Any) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the names of unknown parameters, with those that are known in their place."""
    parameters = given if isinstance(given, dict) else {}
    for name in sorted(parameters):
        if name not in (*PARAMETERS, tenure.PARAMETER):
            yield name, PARAMETERS
    for group, members in GROUPS.items():
        present, known = parameters.get(group), [f"{group}/{each}" for each in members]
        for name in sorted(present) if isinstance(present, dict) else ():
            if name not in members:
                yield f"{group}/{name}", known


class _Parameters(PrivateParameters):
    def warn_of_unknown(self) -> None:
        """Warn of unknown parameters, which would be ignored silently."""
        for name, known in _unknown(self.given):
            hint = did_you_mean(name, known, at_most=1, prefix="~")
            rospy.logwarn("unknown parameter ~%s%s", name, hint or "; known: ~" + " ~".join(known))

    def check_groups(self) -> None:
        for group, members in GROUPS.items():
            expected = f"a namespace with {', '.join(members[:-1])} or {members[-1]}"
            self.read(group, {}, expected, lambda value: isinstance(value, dict))

    def path(self, name: str) -> str:
        """Read a path, and make the parameter absolute: it may be read again in another folder."""
        given = self.string(name)
        path = given and _absolute(given)
        if path != given:
            rospy.set_param(f"~{name}", path)
        return path

    def paths(self, name: str) -> tuple[str, ...]:
        """Read paths, and make the parameter absolute as well."""
        given = self.strings(name)
        paths = tuple(map(_absolute, given))
        if paths != given:
            rospy.set_param(f"~{name}", list(paths))
        return paths

    def topic_patterns(self, name: str) -> tuple[str, ...]:
        """Read patterns of topics; relative ones resolve in the manager's namespace."""
        namespace = names.parent(rospy.get_name())
        return tuple(
            pattern if pattern[:1] in "/*" else names.join(namespace, pattern)
            for pattern in self.strings(name)
        )

    def seconds(
        self, name: str, default: float, least: float, most: float = _MOST_SECONDS
    ) -> float:
        expected = f"seconds, at least {least:g} and at most {most:g}"
        return self.number(name, default, expected, lambda value: least <= value <= most)

    def limits(self, kind: Any, *limits: str) -> dict[str, int]:
        """Read limits by name, as ``~limits/NAME`` sets them."""
        return {limit: self.integer(f"limits/{limit}", getattr(kind, limit)) for limit in limits}


def _absolute(path: str) -> str:
    return os.path.abspath(os.path.expanduser(path))
