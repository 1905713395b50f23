# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Durable state: the manager's promises, kept over ``kill -9``.

A change is on disk before the call that makes it returns, so an acknowledged change survives when
the manager is killed. A disk that does not take a change stops no operation: ``trouble`` explains
it, and the change is written as soon as the disk takes it (``state_file``). Meaningless entries
are set aside, and the others are used. Backups take the place of a damaged file.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import functools
import json
import time
from typing import (
    Any,
    Callable,
    Iterable,
    Mapping,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.manager.record import Heard, Record
from dyknow.manager.specifications.given import set_on_load
from dyknow.manager.state_file import IN_MEMORY, StateFile
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import Parameter, Port, Transformation

#: What reading an entry without a meaning may raise.
MEANINGLESS = (DyKnowError, ValueError, TypeError, KeyError, AttributeError, RecursionError)

_Entry = TypeVar("_Entry")


def pack(transformation: Transformation) -> str:
    """Write a transformation as one line of JSON; earlier versions read it if they can use it."""
    is_plain = not (transformation.isolated or transformation.node)
    return json.dumps(transformation[:6] if is_plain else transformation, separators=(",", ":"))


def unpack(body: str) -> Transformation:
    """Read a transformation that ``pack`` wrote; ValueError or TypeError if it is not one."""
    label, source, kind, cost, parameters, ports, *rest = json.loads(body)
    isolated, node = rest or (False, "")
    texts = [label, source, kind, node]  # checked by hand: there may be hundreds of thousands
    for parameter in parameters:
        texts += parameter
    numbers: list[float] = []
    for name, side, datatype, tags, *stated in ports:  # nothing in files of earlier versions
        texts += (name, side, datatype, *tags)
        numbers += stated
    "".join(texts)
    if type(cost) is not int:
        raise TypeError(f"its cost is {cost!r}")
    if not all(type(number) is float for number in numbers):
        raise TypeError("the rate or latency of a port is no number")
    if type(isolated) is not bool:
        raise TypeError(f"isolated is {isolated!r}")
    return Transformation(
        label,
        source,
        kind,
        cost,
        tuple(Parameter(*each) for each in parameters),
        tuple(
            Port(name, side, datatype, tuple(tags), *stated)
            for name, side, datatype, tags, *stated in ports
        ),
        isolated,
        node,
    )


class Store:
    """The manager's state on disk; safe from any thread."""

    def __init__(self, path: str = IN_MEMORY, clock: Callable[[], float] = time.monotonic) -> None:
        """Open the state, or start an empty one; StoreError if the file is of no use at all."""
        self._file = StateFile(path, clock)

    @property
    def complaint(self) -> str:
        """Description of unusable entries and their new place; empty for none."""
        return self._file.complaint

    @property
    def trouble(self) -> str:
        """Why changes are not on disk yet, and the remedy; empty if they are."""
        return self._file.trouble

    @property
    def remark(self) -> str:
        """Remark for the answer to a request while changes are not on disk; else empty."""
        return f"done, but not on disk yet: {self.trouble}" if self.trouble else ""

    def write_pending(self) -> None:
        self._file.write_pending()

    def back_up(self) -> None:
        self._file.back_up()

    # Facts: small numbers that outlive the process

    def number(self, name: str) -> int:
        """Read a number, 0 if it was never written."""
        return self._read("facts", lambda key, text: int(text)).get(name, 0)

    def set_number(self, name: str, value: int) -> None:
        self._file.write({("facts", name): str(value)})

    # Transformations

    def transformations(self) -> list[Transformation]:
        def read(label: str, body: str) -> Transformation:
            found = unpack(body)
            if found.label != label:
                raise ValueError(f"it says that it is '{found.label}'")
            return found

        return list(self._read("transformations", read).values())

    def put_transformations(
        self, transformations: Iterable[Transformation], library_revision: int
    ) -> None:
        """Add or replace, all of them or none."""
        rows = {("transformations", each.label): pack(each) for each in transformations}
        self._file.write({**rows, ("facts", "library_revision"): str(library_revision)})

    def remove_transformation(self, label: str, library_revision: int) -> None:
        self._file.write(
            {
                ("transformations", label): None,
                ("facts", "library_revision"): str(library_revision),
            }
        )

    # Nodelets

    def nodelets(self) -> list[Record]:
        return list(self._read("nodelets", _record).values())

    def put_nodelet(self, record: Record) -> None:
        self._file.write({("nodelets", record.name): _body(record)})

    def remove_nodelet(self, name: str) -> None:
        self._file.write({("nodelets", name): None})

    # Claims, as their owner writes them

    def claims(self) -> dict[str, dict[str, Any]]:
        return self._read("claims", lambda claim_id, text: dict(json.loads(text)))

    def put_claim(self, claim_id: str, body: dict[str, Any]) -> None:
        self._file.write({("claims", claim_id): json.dumps(body)})

    def remove_claim(self, claim_id: str) -> None:
        self._file.write({("claims", claim_id): None})

    def reject_claims(self, causes: Mapping[str, str]) -> None:
        """Set claims aside that have no meaning, with the causes by id."""
        self._file.reject("claims", causes)

    def end(self) -> None:
        """Forget nodelets and claims: the manager is stopped on purpose. Transformations stay."""
        self._file.write(
            {
                (table, key): None
                for table in ("nodelets", "claims")
                for key in self._file.rows(table)
            }
        )

    def close(self) -> None:
        self._file.close()

    # Inside

    def _read(self, table: str, read: Callable[[str, str], _Entry]) -> dict[str, _Entry]:
        """Read a table; entries without a meaning are set aside."""
        found: dict[str, _Entry] = {}
        causes: dict[str, str] = {}
        for key, text in self._file.rows(table).items():
            try:
                found[key] = read(key, text)
            except MEANINGLESS as error:
                causes[key] = f"{type(error).__name__}: {error}"
        if causes:
            self._file.reject(table, causes)
        return found


def _body(record: Record) -> str:
    body = {each.name: getattr(record, each.name) for each in dataclasses.fields(record)}
    for name in ("name", "ports", "awaited"):  # the key, and observations of each life
        del body[name]
    if not record.heard.ways:
        del body["heard"]  # earlier versions do not read it
    body["transformation"] = pack(record.transformation) if record.transformation else None
    body.update(topics=dict(record.topics), state=int(record.state), kind=record.kind.value)
    return json.dumps(body, sort_keys=True)


def _record(name: str, text: str) -> Record:
    body = json.loads(text)
    made_from = body.pop("transformation")
    transformation = unpack(made_from) if made_from else None
    if "is_fixed" not in body:  # its name in earlier versions, which did not write the kind
        body["is_fixed"] = body.pop("rewired_by_reload")
    plain = NodeletKind.CPP if body["is_fixed"] else NodeletKind.PYTHON
    connections, ways = body.pop("heard", ((), ()))
    given = tuple(Parameter(*each) for each in body.pop("parameters", ()))
    record = Record(
        name=name,
        transformation=transformation,
        state=State(body.pop("state")),
        parameters=given,
        kind=NodeletKind(body.pop("kind", plain)),
        heard=Heard(
            tuple((port, tuple(topics)) for port, topics in connections),
            tuple(tuple((variable, value) for variable, value in way) for way in ways),
        ),
        **body,
    )
    check_types(record)
    if names.check(name, "nodelet name") != name or name[:1] != "/":
        raise ValueError("its name is not global")
    if transformation is not None:
        set_on_load(transformation, given)
    return record


def check_types(value: Any) -> None:
    """Raise TypeError if a field of a dataclass or named tuple has not its declared type."""
    for name, hint in _fields(value.__class__).items():
        if not _fits(getattr(value, name), hint):
            raise TypeError(f"{name} is {getattr(value, name)!r}, expected {_written(hint)}")


@functools.lru_cache(maxsize=None)
def _fields(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _fits(value: Any, hint: Any) -> bool:
    if hint is str:
        return isinstance(value, str)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Union:
        return any(_fits(value, each) for each in arguments)
    if origin is tuple:
        return isinstance(value, tuple) and _fits_tuple(value, arguments)
    if origin is collections.abc.Mapping:
        return isinstance(value, collections.abc.Mapping) and all(
            _fits(key, arguments[0]) and _fits(each, arguments[1]) for key, each in value.items()
        )
    if hint in (int, float):
        kinds = (int, float) if hint is float else (int,)
        return (
            isinstance(value, kinds)
            and not isinstance(value, (bool, enum.Enum))
            and value == value
        )
    if not isinstance(value, hint):
        return False
    if dataclasses.is_dataclass(hint) or hasattr(hint, "_fields"):
        check_types(value)
    return True


def _fits_tuple(values: tuple[Any, ...], hints: tuple[Any, ...]) -> bool:
    if len(hints) == 2 and hints[1] is Ellipsis:
        return all(_fits(each, hints[0]) for each in values)
    return len(values) == len(hints) and all(map(_fits, values, hints))


def _written(hint: Any) -> str:
    return getattr(hint, "__name__", None) or str(hint).replace("typing.", "")
