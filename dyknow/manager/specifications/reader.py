# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads specification XML into drafts."""

from __future__ import annotations

from sys import intern
from typing import Iterator, List, Optional, Union

from dyknow.manager.specifications.draft import (
    ArgDraft,
    ParameterDraft,
    PortDraft,
    TagDraft,
    TransformationDraft,
)
from dyknow.manager.specifications.findings import Findings
from dyknow.manager.specifications.grammar import TRANSFORMATION, TRANSFORMATIONS
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.wellformed import Unreadable
from dyknow.manager.specifications.xml_reader import Attributes, Element, XmlReader


class SpecificationReader(XmlReader):
    """Makes a draft of each transformation that is complete, problems or not."""

    def __init__(self, findings: Findings, limits: SpecificationLimits, *roots: Element) -> None:
        """Prepare to read a specification, or another text with transformations in it."""
        super().__init__(findings, limits, *(roots or (TRANSFORMATION, TRANSFORMATIONS)))
        self._draft = TransformationDraft(0)
        self._ready: List[TransformationDraft] = []
        self._count = 0
        self._items = 0
        self.on_start["transformation"] = self._begin_transformation
        self.on_end["transformation"] = self._end_transformation
        self.on_text.update(
            label=self._label,
            source=self._source,
            arg=self._arg,
            param=self._param,
            port=self._port,
            tag=self._tag,
        )

    def drafts(self, text: Union[str, bytes]) -> Iterator[TransformationDraft]:
        """Read a text; yield its transformations one after the other.

        Args:
            text: The XML, as characters or as UTF-8.
        """
        for _ in self.read(text):
            yield from self._ready
            self._ready.clear()

    def _begin_transformation(self, attributes: Attributes, line: int) -> None:
        self._count += 1
        self._items = 0
        if self._count > self._limits.transformations:
            raise Unreadable(
                line, f"more than {self._limits.transformations} transformations in one text"
            )
        self._draft = TransformationDraft(line)
        self._draft.type = attributes.get("type") or ""
        self._draft.cost = attributes.get("cost", "1") or ""
        self._draft.isolated = attributes.get("isolated") == "true"
        self._draft.node = (attributes["node"] or "") if "node" in attributes else None
        self.has_variables = "${" in self._draft.cost or "${" in (self._draft.node or "")

    def _end_transformation(self, _: Attributes, __: int) -> None:
        self._draft.has_variables = self.has_variables
        self._ready.append(self._draft)

    def _label(self, text: Optional[str], _: Attributes, line: int) -> None:
        if text is not None and self._draft.label is None:
            self._draft.label, self._draft.label_line = text, line

    def _source(self, text: Optional[str], _: Attributes, line: int) -> None:
        if text is not None and self._draft.source is None:
            self._draft.source, self._draft.source_line = text, line

    def _arg(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        label = attributes["label"]
        if label is not None:
            self._draft.args.append(ArgDraft(label, text or "", line))

    def _param(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        name, type_ = attributes["name"], attributes.get("type", "")
        if name is not None and type_ is not None and text is not None:
            self._draft.parameters.append(ParameterDraft(intern(name), type_, text, line))

    def _port(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        direction, datatype = attributes["type"], attributes.get("datatype", "")
        rate, latency = attributes.get("rate", ""), attributes.get("latency", "")
        if (
            text is not None
            and direction is not None
            and datatype is not None
            and rate is not None
            and latency is not None
        ):
            port = PortDraft(intern(text), direction, intern(datatype), line, rate, latency)
            self._draft.ports.append(port)
        else:
            self._draft.ports_known = False

    def _tag(self, text: Optional[str], attributes: Attributes, line: int) -> None:
        self._count_item(line)
        port = attributes["port"]
        if port is not None and text is not None:
            self._draft.tags.append(TagDraft(port, text, line))

    def _count_item(self, line: int) -> None:
        self._items += 1
        if self._items > self._limits.items:
            raise Unreadable(
                line,
                f"more than {self._limits.items} args, params, ports and tags in one "
                "<transformation>",
            )
