# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Templates: one specification that stands for many transformations.

Each `<arg>` is a variable with a set of terms, written out as `{cam1; cam2}` or taken from a
class of the ontology. A transformation results for every combination of terms. Every occurrence
of `${Cam}` is replaced in one pass: the text of a term is not searched for variables. `$${` stands
for `${` itself. Placeholders in the texts of parameters, `${?x}`, stay: a nodelet's variables fill
them when it is made (``model.placeholders``).
"""

from __future__ import annotations

import re
from collections import Counter
from itertools import product
from math import prod
from typing import Collection, Dict, Iterable, Iterator, List, Protocol, Sequence, Tuple, Union

from dyknow.errors import OntologyError
from dyknow.manager.specifications.findings import Findings, listed, meant, shorten
from dyknow.manager.specifications.tags import Subsumption
from dyknow.manager.specifications.xml_reader import BLANK, XmlNode
from dyknow.model import placeholders
from dyknow.model.placeholders import Placeholder

_VARIABLE = re.compile(r"\$\$\{|\$\{([^{}]*)\}|\$\{")
_BESIDE_PLACEHOLDERS = re.compile(r"\$\$\{(?!\?)|\$\{(?!\?)([^{}]*)\}|\$\{(?!\?)")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*\Z")
_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:[^\s<>\"{}|\\^`]+\Z")

_Pieces = List[Union[str, int, Placeholder]]
"""A text cut at its variables: literals, and for each variable its position among the args."""

_AllPieces = Dict[Tuple[str, bool], _Pieces]
"""The pieces of each text, by the text and whether it is a value."""

_Terms = Sequence[Tuple[str, ...]]


class Concepts(Subsumption, Protocol):
    """The part of an ontology that specifications need."""

    def individuals(self, concept: str) -> tuple[str, ...]:
        """Return the labels of a class's individuals, sorted, or raise an `OntologyError`."""

    def unlabelled(self, concept: str) -> tuple[str, ...]:
        """Return the URIs of the individuals without a label; `_:` begins what has no URI."""

    def is_class(self, name: str) -> bool:
        """Whether a name stands for a class."""


class Expander:
    """Expands the templates of one text; the limits hold for all of them together."""

    def __init__(self, findings: Findings, ontology: Concepts | None) -> None:
        self._findings = findings
        self._ontology = ontology
        self._transformations = 0
        self._items = 0
        self._characters = 0

    def expand(self, node: XmlNode) -> Iterable[XmlNode] | None:
        """Expand a `<transformation>`.

        Returns:
            Transformations without variables, one for every combination of terms, the last
            variable varying fastest. None if the template has problems, which were noted.
        """
        args = node.all("args")
        if not args and not node.has_variables:
            return [node]
        node.children = [each for each in node.children if each.name != "args"]
        names = {arg.get("label"): number for number, arg in enumerate(args)}
        terms = self._all_terms(args)
        pieces = self._cut(node, names)
        if terms is None or pieces is None or not self._labels_differ(node, names, terms):
            return None
        self._check_arguments(node, args, terms)
        if not self._fits(node, pieces, terms):
            return None
        return _substitutions(node, pieces, terms)

    def _all_terms(self, args: list[XmlNode]) -> _Terms | None:
        lines: dict[str, int] = {}
        sets: list[tuple[str, ...]] = []
        for arg in args:
            label = arg.get("label")
            if not _NAME.match(label):
                self._problem(
                    arg, "has no name for a label; expected letters, digits, '_', '-' and '.'"
                )
            if label in lines:
                self._problem(arg, f"is there already, in line {lines[label]}")
            lines.setdefault(label, arg.line)
            sets.append(self._terms(arg))
        return sets if all(sets) and len(lines) == len(args) else None

    def _terms(self, arg: XmlNode) -> tuple[str, ...]:
        """Return the terms of one arg; empty if there is a problem with them."""
        text = arg.text
        if text.startswith("{") and text.endswith("}") and len(text) > 1:
            return self._explicit_terms(arg)
        if not _URI.match(text):
            self._problem(
                arg, "has no terms; expected a set such as {cam1; cam2} or the URI of a class"
            )
            return ()
        if self._ontology is None:
            self._problem(arg, f"names the class <{shorten(text)}>, but no ontology is loaded")
            return ()
        try:
            terms = self._ontology.individuals(text)
        except OntologyError as error:
            self._problem(arg, f"has no terms: {error}")
            return ()
        unlabelled = self._ontology.unlabelled(text)
        anonymous = [uri for uri in unlabelled if uri.startswith("_:")]
        if anonymous:
            self._findings.warning(
                arg.line,
                f"individuals of the class <{shorten(text)}> that have neither a URI nor a label "
                f"are left out: {len(anonymous)}",
            )
        for uri in unlabelled:
            if uri not in anonymous:
                self._findings.warning(
                    arg.line,
                    f"the individual <{shorten(uri)}> has no label; it goes by the last part of "
                    "its URI",
                )
        if not terms:
            self._problem(arg, f"has no terms: the class <{shorten(text)}> has no individuals")
        return terms

    def _check_arguments(self, node: XmlNode, args: list[XmlNode], terms: _Terms) -> None:
        """Warn about labels of individuals that are no single argument of a tag."""
        tags = [tag.text for tag in node.all("tags")]
        for arg, found in zip(args, terms):
            is_used = any(f"${{{arg.get('label')}}}" in tag for tag in tags)
            for term in found if is_used and not arg.text.startswith("{") else ():
                if set(term) & set("(),?"):
                    self._findings.warning(
                        arg.line,
                        f"the individual '{shorten(term)}' is no single argument of a tag: its "
                        "label has one of '(', ')', ',' and '?'",
                    )

    def _explicit_terms(self, arg: XmlNode) -> tuple[str, ...]:
        terms = tuple(term.strip(BLANK) for term in arg.text[1:-1].split(";"))
        if "" in terms:
            self._problem(arg, "has an empty term; expected terms around each ';' in {...}")
            return ()
        doubled = [term for term, count in Counter(terms).items() if count > 1]
        if doubled:
            self._problem(arg, f"has a term twice: {listed(doubled)}")
            return ()
        return terms

    def _problem(self, arg: XmlNode, message: str) -> None:
        self._findings.problem(arg.line, f"the arg '{shorten(arg.get('label'))}' {message}")

    def _cut(self, node: XmlNode, names: dict[str, int]) -> _AllPieces | None:
        """Cut all texts at their variables, and values also at their placeholders.

        Returns the pieces of each text; None if one has a problem, which was noted.
        """
        found: _AllPieces = {}
        good = True
        for text, line, is_value in node.texts():
            parts: Iterable[str | Placeholder] = (text,)
            fault = ""
            if is_value:
                try:
                    parts = placeholders.cut(text)
                except ValueError as error:
                    fault = f"{error} (write $${{? for ${{? itself)"
            pieces: _Pieces = []
            for part in parts:
                if isinstance(part, Placeholder):
                    pieces.append(part)
                    continue
                end = 0
                for match in (_BESIDE_PLACEHOLDERS if is_value else _VARIABLE).finditer(part):
                    known = "${" if match.group() == "$${" else names.get(match.group(1))
                    if known is None:
                        good = False
                        self._findings.problem(line, _unknown(match, names))
                    else:
                        pieces += [part[end : match.start()], known]
                    end = match.end()
                pieces.append(part[end:])
            if fault:
                good = False
                self._findings.problem(line, fault)
            found[text, is_value] = [piece for piece in pieces if piece != ""]
        return found if good else None

    def _labels_differ(self, node: XmlNode, names: dict[str, int], terms: _Terms) -> bool:
        label = node.child("label")
        if label is None:
            return False
        used = {match.group(1) for match in _VARIABLE.finditer(label.text)}
        for name, number in names.items():
            if name not in used and len(terms[number]) > 1:
                self._findings.problem(
                    label.line,
                    f"{len(terms[number])} transformations would have the same label; expected "
                    f"${{{name}}} in the label '{shorten(label.text)}'",
                )
                return False
        return True

    def _fits(self, node: XmlNode, pieces: _AllPieces, terms: _Terms) -> bool:
        """Compute the size of the expansion, and check the limits before anything is expanded."""
        limits = self._findings.limits
        count = prod(len(each) for each in terms)
        transformations = self._transformations + count
        items = self._items + count * sum(
            len(node.all(section)) for section in ("params", "ports", "tags")
        )
        totals = [sum(map(len, each)) * (count // len(each)) for each in terms]
        longest = [max(map(len, each)) for each in terms]
        characters = self._characters
        too_long = None
        for text, line, is_value in node.texts():
            cut = pieces[text, is_value]
            most = sum(longest[p] if isinstance(p, int) else _length(p) for p in cut)
            characters += sum(totals[p] if isinstance(p, int) else _length(p) * count for p in cut)
            if most > limits.string_length and too_long is None:
                expected = f"expected at most {limits.string_length}"
                too_long = (line, f"a value of {most} characters would result; {expected}")
        for number, limit, what in (
            (transformations, limits.transformations, "transformations in this text"),
            (items, limits.expanded_items, "params, ports and tags would result in all"),
            (characters, limits.expanded_size, "characters would result in all"),
        ):
            if number > limit:
                self._findings.problem(node.line, f"{number} {what}; expected at most {limit}")
                return False
        if too_long is not None:
            self._findings.problem(*too_long)
            return False
        self._transformations, self._items, self._characters = transformations, items, characters
        return True


def _length(piece: str | Placeholder) -> int:
    return len(piece) if isinstance(piece, str) else len(piece.variable)


def _unknown(match: re.Match[str], names: Collection[str]) -> str:
    """Word the problem of a variable that is none of the args."""
    found, name = match.group(), match.group(1) or ""
    if name[:1] == "?":
        return (
            f"{shorten(found)} stands outside the text of a <param>, where a variable of tags "
            "cannot be filled in (write $${ for ${ itself)"
        )
    shown = "'${' without '}'" if found == "${" else shorten(found)
    return (
        f"unknown variable {shown}; known variables: {listed(names)} (write $${{ for ${{ "
        f"itself){meant(name, names)}"
    )


def _substitutions(node: XmlNode, pieces: _AllPieces, terms: _Terms) -> Iterator[XmlNode]:
    fixed = {
        key: _joined(cut, key[1])
        for key, cut in pieces.items()
        if not any(isinstance(piece, int) for piece in cut)
    }
    for choice in product(*terms):

        def render(text: str, is_value: bool, choice: tuple[str, ...] = choice) -> str:
            key = (text, is_value)
            if key in fixed:
                return fixed[key]
            filled: _Pieces = [
                choice[each] if isinstance(each, int) else each for each in pieces[key]
            ]
            return _joined(filled, is_value)

        yield node.rendered(render)


def _joined(pieces: _Pieces, is_value: bool) -> str:
    texts = [piece for piece in pieces if not isinstance(piece, int)]
    return placeholders.join(texts) if is_value else "".join(map(str, texts))
