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
from typing import Dict, Iterator, List, Optional, Protocol, Sequence, Tuple, Union

from dyknow.errors import OntologyError
from dyknow.manager.specifications.findings import Findings, listed, meant, shorten
from dyknow.manager.specifications.limits import SpecificationLimits
from dyknow.manager.specifications.reader import ArgDraft, TransformationDraft
from dyknow.manager.specifications.tags import Subsumption
from dyknow.manager.specifications.xml_reader import BLANK
from dyknow.model import placeholders
from dyknow.model.placeholders import Placeholder

_VARIABLE = re.compile(r"\$\$\{|\$\{([^{}]*)\}|\$\{")
_BESIDE_PLACEHOLDERS = re.compile(r"\$\$\{(?!\?)|\$\{(?!\?)([^{}]*)\}|\$\{(?!\?)")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*\Z")
_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:[^\s<>\"{}|\\^`]+\Z")

_Pieces = Tuple[Union[str, int], ...]
"""A text cut at its variables: literals, and for each variable its position among the args."""

_ValuePieces = Tuple[Union[str, int, Placeholder], ...]
"""The text of a parameter, which is cut at its placeholders too."""

_Texts = Dict[str, _Pieces]
_Values = Dict[str, _ValuePieces]
_Terms = Sequence[Tuple[str, ...]]


class Concepts(Subsumption, Protocol):
    """The part of an ontology that specifications need."""

    def individuals(self, concept: str) -> Tuple[str, ...]:
        """Return the labels of a class's individuals, sorted, or raise an `OntologyError`."""

    def unlabelled(self, concept: str) -> Tuple[str, ...]:
        """Return the URIs of the individuals without a label."""

    def is_class(self, name: str) -> bool:
        """Whether a name stands for a class."""


class Expander:
    """Expands the templates of one text; the limits hold for all of them together."""

    def __init__(
        self, findings: Findings, limits: SpecificationLimits, ontology: Optional[Concepts]
    ) -> None:
        self._findings = findings
        self._limits = limits
        self._ontology = ontology
        self._transformations = 0
        self._items = 0
        self._characters = 0

    def expand(self, draft: TransformationDraft) -> Optional[Iterator[TransformationDraft]]:
        """Expand a draft.

        Args:
            draft: A draft with variables, or without any.

        Returns:
            An iterator over drafts without variables, one for every combination of terms, the
            last variable varying fastest. None if the template has problems, which were noted.
        """
        terms = self._all_terms(draft.args)
        positions = {arg.label: position for position, arg in enumerate(draft.args)}
        known = self._variables_are_known(draft, positions)
        if terms is None or not known or not self._labels_differ(draft, positions, terms):
            return None
        texts = {text: _cut(text, positions) for text, _ in draft.texts()}
        values = {text: _cut_value(text, positions) for text, _ in draft.values()}
        if not self._fits(draft, texts, values, terms):
            return None
        return _substitutions(draft, texts, values, terms)

    def _all_terms(self, args: List[ArgDraft]) -> Optional[_Terms]:
        lines: Dict[str, int] = {}
        sets: List[Tuple[str, ...]] = []
        for arg in args:
            if not _NAME.match(arg.label):
                self._problem(
                    arg, "has no name for a label; expected letters, digits, '_', '-' and '.'"
                )
            if arg.label in lines:
                self._problem(arg, f"is there already, in line {lines[arg.label]}")
            lines.setdefault(arg.label, arg.line)
            sets.append(self._terms(arg))
        return sets if all(sets) and len(lines) == len(args) else None

    def _terms(self, arg: ArgDraft) -> Tuple[str, ...]:
        """Return the terms of one arg; empty if there is a problem with them."""
        text = arg.terms
        if text.startswith("{") and text.endswith("}") and len(text) > 1:
            return self._explicit_terms(arg)
        if not _URI.match(text):
            self._problem(
                arg,
                "has no terms; expected a set such as {cam1; cam2} or the URI of a class",
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
        for uri in self._ontology.unlabelled(text):
            self._findings.warning(
                arg.line,
                f"the individual <{shorten(uri)}> has no label; it goes by the last part of its "
                "URI",
            )
        if not terms:
            self._problem(arg, f"has no terms: the class <{shorten(text)}> has no individuals")
        return terms

    def _explicit_terms(self, arg: ArgDraft) -> Tuple[str, ...]:
        terms = tuple(term.strip(BLANK) for term in arg.terms[1:-1].split(";"))
        if "" in terms:
            self._problem(arg, "has an empty term; expected terms around each ';' in {...}")
            return ()
        if len(set(terms)) < len(terms):
            doubled = [term for term, count in Counter(terms).items() if count > 1]
            self._problem(arg, f"has a term twice: {listed(doubled)}")
            return ()
        return terms

    def _problem(self, arg: ArgDraft, message: str) -> None:
        self._findings.problem(arg.line, f"the arg '{shorten(arg.label)}' {message}")

    def _variables_are_known(self, draft: TransformationDraft, positions: Dict[str, int]) -> bool:
        good = True
        for text, line in draft.texts():
            for match in _VARIABLE.finditer(text):
                good = self._is_known(match, positions, line) and good
        for text, line in draft.values():
            for match in _BESIDE_PLACEHOLDERS.finditer(text):
                good = self._is_known(match, positions, line) and good
            try:
                placeholders.cut(text)
            except ValueError as error:
                good = False
                self._findings.problem(line, f"{error} (write $${{? for ${{? itself)")
        return good

    def _is_known(self, match: re.Match[str], positions: Dict[str, int], line: int) -> bool:
        found, name = match.group(), match.group(1)
        if found == "$${" or name in positions:
            return True
        if name and name[0] == "?":
            self._findings.problem(
                line,
                f"{shorten(found)} stands outside the text of a <param>, where a variable of tags "
                "cannot be filled in (write $${ for ${ itself)",
            )
            return False
        shown = "'${' without '}'" if found == "${" else shorten(found)
        self._findings.problem(
            line,
            f"unknown variable {shown}; known variables: {listed(positions)} (write $${{ for ${{ "
            f"itself){meant(name or '', positions)}",
        )
        return False

    def _labels_differ(
        self, draft: TransformationDraft, positions: Dict[str, int], terms: _Terms
    ) -> bool:
        used = {match.group(1) for match in _VARIABLE.finditer(draft.label or "")}
        good = draft.label is not None
        for name, position in positions.items():
            if good and name not in used and len(terms[position]) > 1:
                good = False
                self._findings.problem(
                    draft.label_line,
                    f"{len(terms[position])} transformations would have the same label; expected "
                    f"${{{name}}} in the label '{shorten(draft.label or '')}'",
                )
        return good

    def _fits(
        self, draft: TransformationDraft, texts: _Texts, values: _Values, terms: _Terms
    ) -> bool:
        """Compute the size of the expansion, and check the limits before anything is expanded."""
        count = prod(len(each) for each in terms)
        if self._transformations + count > self._limits.transformations:
            self._findings.problem(
                draft.line,
                f"{self._transformations + count} transformations in this text; expected at most "
                f"{self._limits.transformations}",
            )
            return False
        each_items = len(draft.parameters) + len(draft.ports) + len(draft.tags)
        if self._items + count * each_items > self._limits.expanded_items:
            self._findings.problem(
                draft.line,
                f"{self._items + count * each_items} params, ports and tags would result in all; "
                f"expected at most {self._limits.expanded_items}",
            )
            return False
        totals = [sum(map(len, each)) * (count // len(each)) for each in terms]
        longest = [max(map(len, each)) for each in terms]
        characters = 0
        every: List[Tuple[_ValuePieces, int]] = [
            (texts[text], line) for text, line in draft.texts()
        ]
        every += [(values[text], line) for text, line in draft.values()]
        for pieces, line in every:
            most = sum(longest[p] if isinstance(p, int) else _length(p) for p in pieces)
            if most > self._limits.string_length:
                self._findings.problem(
                    line,
                    f"a value of {most} characters would result; expected at most "
                    f"{self._limits.string_length}",
                )
                return False
            characters += sum(
                totals[p] if isinstance(p, int) else _length(p) * count for p in pieces
            )
        if self._characters + characters > self._limits.expanded_size:
            self._findings.problem(
                draft.line,
                f"{self._characters + characters} characters would result in all; expected at "
                f"most {self._limits.expanded_size}",
            )
            return False
        self._transformations += count
        self._items += count * each_items
        self._characters += characters
        return True


def _length(piece: Union[str, Placeholder]) -> int:
    return len(piece) if isinstance(piece, str) else len(piece.variable)


def _cut(text: str, positions: Dict[str, int], variables: re.Pattern[str] = _VARIABLE) -> _Pieces:
    """Cut a text at its variables, which are known."""
    pieces: List[Union[str, int]] = []
    end = 0
    for match in variables.finditer(text):
        pieces.append(text[end : match.start()])
        if match.group() == "$${":
            pieces.append("${")
        else:
            pieces.append(positions.get(match.group(1), match.group()))
        end = match.end()
    pieces.append(text[end:])
    return tuple(piece for piece in pieces if piece != "")


def _cut_value(text: str, positions: Dict[str, int]) -> _ValuePieces:
    """Cut the text of a parameter at its placeholders, and the rest at its variables."""
    pieces: List[Union[str, int, Placeholder]] = []
    for piece in placeholders.cut(text):
        if isinstance(piece, str):
            pieces += _cut(piece, positions, _BESIDE_PLACEHOLDERS)
        else:
            pieces.append(piece)
    return tuple(pieces)


def _substitutions(
    draft: TransformationDraft, texts: _Texts, values: _Values, terms: _Terms
) -> Iterator[TransformationDraft]:
    for choice in product(*terms):

        def render(text: str, choice: Tuple[str, ...] = choice) -> str:
            return "".join([choice[p] if isinstance(p, int) else p for p in texts[text]])

        def render_value(text: str, choice: Tuple[str, ...] = choice) -> str:
            return placeholders.join(choice[p] if isinstance(p, int) else p for p in values[text])

        yield draft.map(render, render_value)
