# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The kinds of chains that are compared, and how each is set up."""

from __future__ import annotations

import sys
from typing import Callable, Dict, Optional, Sequence

from dyknow_benchmark.control import ChainControl
from dyknow_benchmark.managers import RunningManager
from dyknow_benchmark.session import Session, executable

#: What the names of a kind's nodelets begin with.
_PREFIXES = {"dyknow": "", "nodelet": "Plain", "cpp_nodelet": "Cpp", "cpp_live": "Cpp"}


class Chains:
    """Sets chains up in a session; those of nodelets share one manager of their language."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._python: Optional[RunningManager] = None
        self._cpp: Optional[RunningManager] = None
        self._cpp_live_manager: Optional[RunningManager] = None
        self._builders: Dict[str, Callable[[str, int, Sequence[int], str], None]] = {
            "dyknow": self._dyknow,
            "nodelet": self._nodelet,
            "function": self._function,
            "rospy": self._rospy,
            "node": self._node,
            "script": self._script,
            "cpp_nodelet": self._cpp_nodelet,
            "cpp_live": self._cpp_live,
            "mixed": self._mixed,
            "cpp_node": self._cpp_node,
        }

    @property
    def python(self) -> RunningManager:
        """DyKnow's nodelet manager, started when first needed."""
        if self._python is None:
            self._python = RunningManager.python(self._session)
        return self._python

    @property
    def cpp(self) -> RunningManager:
        """The stock nodelet manager, started when first needed."""
        if self._cpp is None:
            self._cpp = RunningManager.cpp(self._session)
        return self._cpp

    @property
    def cpp_live(self) -> RunningManager:
        """DyKnow's nodelet manager in C++, started when first needed."""
        if self._cpp_live_manager is None:
            self._cpp_live_manager = RunningManager.cpp_live(self._session)
        return self._cpp_live_manager

    def build(
        self, kind: str, length: int, record: Sequence[int], payload: str = "time", name: str = ""
    ) -> ChainControl:
        """Set up a chain and return once messages go all the way through it.

        Args:
            kind: a key of ``kinds.KINDS``, or ``mixed``: DyKnow nodelets and C++ ones with live
                ports by turns.
            length: number of hops.
            record: hops that report.
            payload: what is sent: ``time``, or a size of images.
            name: tells it from others of the same kind and payload.

        Raises:
            MeasurementFailed: it does not come up.
        """
        control = f"/benchmark/{kind}_{payload}{name}"
        self._builders[kind](control, length, record, payload)
        return self._settled(control, record)

    def build_fan(self, kind: str, receivers: int) -> ChainControl:
        """Set up a source and receivers that all listen to it; all of them report.

        Args:
            kind: ``dyknow``, ``nodelet`` or ``cpp_nodelet``.
            receivers: how many.

        Raises:
            MeasurementFailed: it does not come up.
        """
        control = f"/benchmark/{kind}_fan_{receivers}"
        everyone = range(1, receivers + 1)
        manager = self.cpp if kind == "cpp_nodelet" else self.python
        prefix = _PREFIXES[kind]
        for number in everyone:
            load_hop(manager, prefix, control, number, f"{control}/hop_0", True)
        load_source(manager, prefix, control)
        return self._settled(control, everyone)

    def _settled(self, control: str, record: Sequence[int]) -> ChainControl:
        chain = ChainControl(control, record)
        chain.settle(self._session)
        return chain

    def _dyknow(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        _load_chain(self.python, "dyknow", control, length, record, payload)

    def _nodelet(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        _load_chain(self.python, "nodelet", control, length, record, payload)

    def _cpp_nodelet(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        _load_chain(self.cpp, "cpp_nodelet", control, length, record, payload)

    def _cpp_live(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        _load_chain(self.cpp_live, "cpp_live", control, length, record, payload)

    def _mixed(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        places = ((self.cpp_live, "cpp_live"), (self.python, "dyknow"))
        for hop in range(length, 0, -1):
            manager, kind = places[hop % 2]
            topic = f"{control}/hop_{hop - 1}"
            load_hop(manager, _PREFIXES[kind], control, hop, topic, hop in record, payload)
        load_source(self.python, _PREFIXES["dyknow"], control, payload)

    def _function(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        self._process("function", control, payload, "--length", length, "--record", *record)

    def _rospy(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        self._process("rospy", control, payload, "--length", length, "--record", *record)

    def _node(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        for hop in range(length, 0, -1):
            self._process("hop", control, payload, "--hop", hop, "--record", *record)
        self._process("source", control, payload)

    def _script(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        for hop in range(length, 0, -1):
            self.load_script(control, "hop", payload, hop, record)
        self.load_script(control, "source", payload)

    def load_script(
        self, control: str, part: str, payload: str, hop: int = 0, record: Sequence[int] = ()
    ) -> None:
        """Load a part of a chain that is a script: a hop, with its number, or the source."""
        options = ["--control", control, "--payload", payload, "--hop", str(hop), "--record"]
        self.python.load(
            f"{control}/{part}_{hop}",
            "dyknow/Script",
            my_argv=["dyknow/benchmark_node", part, *options, *map(str, record)],
        )

    def _process(self, part: str, control: str, payload: str, *options: object) -> None:
        self._session.start(
            [sys.executable, "-m", "dyknow_benchmark.process", part]
            + ["--control", control, "--payload", payload]
            + [str(option) for option in options]
        )

    def _cpp_node(self, control: str, length: int, record: Sequence[int], payload: str) -> None:
        program = executable("dyknow", "benchmark_chain")
        for hop in range(length, 0, -1):
            self._session.start(
                [
                    program,
                    "hop",
                    f"in:={control}/hop_{hop - 1}",
                    f"out:={control}/hop_{hop}",
                    f"_control:={control}",
                    f"_hop:={hop}",
                    f"_record:={hop in record}".lower(),
                ]
            )
        self._session.start([program, "source", f"out:={control}/hop_0", f"_control:={control}"])


def load_hops(
    manager: RunningManager,
    prefix: str,
    control: str,
    length: int,
    record: Sequence[int] = (),
    payload: str = "time",
) -> None:
    """Load the hops of a chain of nodelets, the last first, so that each finds its listener.

    Args:
        manager: where they run.
        prefix: ``Plain``, ``Cpp``, or nothing for those with ports.
        control: namespace of the chain.
        length: number of hops.
        record: hops that report.
        payload: what is sent.
    """
    for hop in range(length, 0, -1):
        load_hop(manager, prefix, control, hop, f"{control}/hop_{hop - 1}", hop in record, payload)


def load_hop(
    manager: RunningManager,
    prefix: str,
    control: str,
    hop: int,
    topic: str,
    record: bool,
    payload: str = "time",
) -> None:
    """Load a hop that listens to a topic; the arguments are those of ``load_hops``."""
    manager.load(
        f"{control}/nodelet_{hop}",
        f"dyknow_benchmark/{prefix}ChainHop",
        {f"{control}/in": topic, f"{control}/out": f"{control}/hop_{hop}"},
        {"control": control, "payload": payload, "hop": hop, "record": record},
    )


def load_source(manager: RunningManager, prefix: str, control: str, payload: str = "time") -> None:
    """Load the source of a chain; the arguments are those of ``load_hops``."""
    manager.load(
        f"{control}/source",
        f"dyknow_benchmark/{prefix}ChainSource",
        {f"{control}/out": f"{control}/hop_0"},
        {"control": control, "payload": payload},
    )


def _load_chain(
    manager: RunningManager,
    kind: str,
    control: str,
    length: int,
    record: Sequence[int],
    payload: str,
) -> None:
    load_hops(manager, _PREFIXES[kind], control, length, record, payload)
    load_source(manager, _PREFIXES[kind], control, payload)
