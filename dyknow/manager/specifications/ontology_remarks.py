# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Warnings about statements of an ontology that are not read, with line and term.

rdflib does not keep lines, so they are searched: the nearest place after a mention of the term
where the construct is named.
"""

from __future__ import annotations

import bisect
import re
from typing import Dict, Iterator, List, NamedTuple, Sequence, Tuple

import rdflib
from rdflib import OWL, RDF, RDFS

from dyknow.errors import Problem

#: The most remarks that are listed for one file.
LISTED = 100
_EXPRESSIONS = (OWL.oneOf, OWL.unionOf, OWL.intersectionOf)


class _Remark(NamedTuple):
    """A statement that is not read: its subject, and the word that names the construct."""

    term: str
    word: str
    message: str


def remarks_on(graph: rdflib.Graph, file: str, data: bytes) -> Tuple[Problem, ...]:
    """Find the statements of one file that are not read.

    Args:
        graph: the file alone.
        file: its name in messages.
        data: its text.
    """
    found = sorted({*_expressions(graph), *_superclasses(graph), *_others(graph)})
    places = _Places(data.decode("utf-8", "replace").splitlines())
    problems = [
        Problem(file, places.line(local_name(each.term), each.word), each.message)
        for each in found[:LISTED]
    ]
    if len(found) > LISTED:
        problems.append(Problem(file, 0, f"{len(found) - LISTED} more such remarks"))
    return tuple(sorted(problems, key=lambda problem: (problem.line == 0, problem.line)))


def local_name(uri: str) -> str:
    """Return the last part of a URI; all of it if there is no such part."""
    return uri.rsplit("#", 1)[-1].rsplit("/", 1)[-1] or uri


def _expressions(graph: rdflib.Graph) -> Iterator[_Remark]:
    for predicate in _EXPRESSIONS:
        word = local_name(str(predicate))
        for subject in graph.subjects(predicate):
            if isinstance(subject, rdflib.URIRef):
                message = f"owl:{word} of <{subject}> is not read"
                yield _Remark(str(subject), word, message)
    for one, other in graph.subject_objects(OWL.equivalentClass):
        for named, blank in ((one, other), (other, one)):
            if isinstance(named, rdflib.URIRef) and isinstance(blank, rdflib.BNode):
                word, what = _inside(graph, blank)
                message = f"owl:equivalentClass of <{named}> with {what} is not read"
                yield _Remark(str(named), word or "equivalentClass", message)


def _superclasses(graph: rdflib.Graph) -> Iterator[_Remark]:
    for lower, upper in graph.subject_objects(RDFS.subClassOf):
        if isinstance(lower, rdflib.URIRef) and isinstance(upper, rdflib.BNode):
            word, what = _inside(graph, upper)
            message = f"a superclass of <{lower}> without a name, {what}, is not read"
            yield _Remark(str(lower), word or "subClassOf", message)


def _inside(graph: rdflib.Graph, blank: rdflib.BNode) -> Tuple[str, str]:
    """The word that names a class expression in the file, and its name in messages."""
    for predicate in _EXPRESSIONS:
        if (blank, predicate, None) in graph:
            word = local_name(str(predicate))
            return word, f"owl:{word}"
    if (blank, RDF.type, OWL.Restriction) in graph:
        return "Restriction", "an owl:Restriction"
    return "", "a class expression"


def _others(graph: rdflib.Graph) -> Iterator[_Remark]:
    for _, imported in graph.subject_objects(OWL.imports):
        message = f"owl:imports of <{imported}> is not followed; name the file too"
        yield _Remark(str(imported), "imports", message)
    labels: Dict[str, Dict[str, str]] = {}
    for subject, label in graph.subject_objects(RDFS.label):
        if isinstance(subject, rdflib.URIRef) and isinstance(label, rdflib.Literal):
            labels.setdefault(str(subject), {})[label.language or ""] = str(label).strip()
    for subject_uri, by_language in labels.items():
        if len(set(by_language.values())) > 1 and len(by_language) > 1:
            chosen = by_language[min(by_language, key=language_order)]
            languages = ", ".join(sorted(language or "none" for language in by_language))
            message = (
                f"<{subject_uri}> has labels in several languages ({languages}); its term is "
                f"'{chosen}'"
            )
            yield _Remark(subject_uri, "label", message)


def language_order(language: str) -> Tuple[int, str]:
    """Sort languages of labels: none, English, the others by their codes."""
    code = language.lower()
    return (0 if not code else 1 if code.split("-")[0] == "en" else 2), code


class _Places:
    """Finds lines of a text."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._lines = lines
        self._numbers: Dict[str, List[int]] = {}

    def line(self, term: str, word: str) -> int:
        """The line of the word's first occurrence after the term; 0 if there is none."""
        words = self._of(word)
        best: Tuple[int, int] = (len(self._lines) + 1, 0)
        for mention in self._of(term):
            place = bisect.bisect_left(words, mention)
            if place < len(words):
                best = min(best, (words[place] - mention, words[place]))
        return best[1] or next(iter(self._of(term)), 0)

    def _of(self, word: str) -> List[int]:
        if word not in self._numbers:
            pattern = re.compile(rf"(?<![\w-]){re.escape(word)}(?![\w-])")
            self._numbers[word] = [
                number for number, text in enumerate(self._lines, 1) if pattern.search(text)
            ]
        return self._numbers[word]
