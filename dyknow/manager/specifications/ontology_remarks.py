# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Warnings about an ontology: skipped statements and doubtful names, with file and line.

rdflib does not keep lines, so they are searched: the nearest place after a mention of the term
where the construct is named.
"""

from __future__ import annotations

import bisect
import re
from typing import Dict, List, NamedTuple, Sequence, Set, Tuple

import rdflib

from dyknow.errors import Problem
from dyknow.manager.specifications.ontology_files import OntologyFile
from dyknow.manager.specifications.ontology_names import Labels, Naming, is_blank, local_name
from dyknow.manager.specifications.ontology_statements import UnreadExpression

#: The most remarks that are listed for one file.
LISTED = 100
#: The URIs that one remark lists.
_URIS = 5
_KINDS = {"": "a class expression", "Restriction": "an owl:Restriction"}


class _Remark(NamedTuple):
    """A warning: the term that it is about, and the word that names the construct, if any."""

    term: str
    word: str
    message: str


class Remarks:
    """The warnings about the files of an ontology."""

    def __init__(self, files: Sequence[OntologyFile]) -> None:
        self._files = {file.path: file for file in files}
        self._remarks: Dict[str, Set[_Remark]] = {path: set() for path in self._files}

    def not_read(self, path: str, expression: UnreadExpression) -> None:
        """Note an expression that is not read."""
        what = _KINDS.get(expression.word, f"owl:{expression.word}")
        message = f"{what} in the description of <{expression.owner}> is not read"
        self._note(path, expression.owner, expression.word, message)

    def not_imported(self, path: str, uri: str) -> None:
        """Note an import that no file satisfies."""
        message = (
            f"owl:imports of <{uri}> is not followed: no file that was named is this ontology, "
            "and no catalogue names a local file for it"
        )
        self._note(path, uri, "imports", message)

    def too_many_unions(self) -> None:
        """Note that not all superclasses of unions were looked for."""
        message = "too many unions to find all superclasses that the parts of each have in common"
        self._note(next(iter(self._files)), "unionOf", "", message)

    def names(self, labels: Labels, classes: Naming, individuals: Naming) -> None:
        """Note the names that are not labels in the preferred language."""
        for label, entities in labels.left.items():
            for entity in entities:
                message = (
                    f"the label '{label.text}' of <{entity}> in '{label.language}' is that of "
                    f"another one too, and there is none in '{labels.language}'; it does not count"
                )
                self._note(label.file, entity, "label", message)
        for naming in (classes, individuals):
            for entity, found in labels.fallbacks(naming):
                languages = ", ".join(sorted({label.language for label in found}))
                message = (
                    f"<{entity}> has labels in several languages ({languages}), none in "
                    f"'{labels.language}'; its term is '{found[0].text}'"
                )
                self._note(found[0].file, entity, "label", message)
            for name, entities in naming.ambiguous.items():
                message = f"{_uris(entities)} have no label, and '{name}' names none of them"
                self._note(self._home(entities[0]), entities[0], "", message)
        for name in classes.shared_with(individuals):
            kind = classes.get(name)
            message = f"'{name}' names the class <{kind}> and the individual "
            self._note(self._home(str(kind)), str(kind), "", f"{message}<{individuals.get(name)}>")
        unlabelled: Dict[str, List[str]] = {}
        for entity in (*classes.unlabelled, *individuals.unlabelled):
            unlabelled.setdefault(self._home(entity), []).append(entity)
        for path, entities in unlabelled.items():
            message = f"no label, so that the last part of the URI is the name: {_uris(entities)}"
            self._note(path, entities[0], "", message)

    def problems(self) -> List[Problem]:
        """Return the warnings of each file by line, those without a line last."""
        return [
            problem
            for path, remarks in self._remarks.items()
            for problem in _placed(self._files[path], sorted(remarks))
        ]

    def _note(self, path: str, term: str, word: str, message: str) -> None:
        self._remarks[path].add(_Remark(term, word, message))

    def _home(self, entity: str) -> str:
        """Return the first file that states something of an entity, else the first one."""
        if len(self._files) > 1 and not is_blank(entity):
            node = rdflib.URIRef(entity)
            for path, file in self._files.items():
                if (node, None, None) in file.graph:
                    return path
        return next(iter(self._files))


def _uris(entities: Sequence[str]) -> str:
    more = f" and {len(entities) - _URIS} more" if len(entities) > _URIS else ""
    return ", ".join(f"<{each}>" for each in entities[:_URIS]) + more


def _placed(file: OntologyFile, remarks: Sequence[_Remark]) -> List[Problem]:
    if not remarks:
        return []
    places = _Places(file.data.decode("utf-8", "replace"))
    problems = [
        Problem(file.path, places.line(local_name(each.term), each.word), each.message)
        for each in remarks[:LISTED]
    ]
    if len(remarks) > LISTED:
        message = f"{len(remarks) - LISTED} more such remarks"
        problems.append(Problem(file.path, 0, message))
    return sorted(problems, key=lambda problem: (problem.line == 0, problem.line))


class _Places:
    """Finds lines of a text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._ends = [found.start() for found in re.finditer("\n", text)]
        self._numbers: Dict[str, List[int]] = {}

    def line(self, term: str, word: str) -> int:
        """The line of the word's first occurrence after the term; that of the term if none is."""
        mentions = self._of(term)
        words = self._of(word) if word else []
        best: Tuple[int, int] = (len(self._ends) + 2, 0)
        for mention in mentions:
            place = bisect.bisect_left(words, mention)
            if place < len(words):
                best = min(best, (words[place] - mention, words[place]))
        return best[1] or next(iter(mentions), 0)

    def _of(self, word: str) -> List[int]:
        """The lines that have the word, not as a part of a longer one."""
        if word not in self._numbers:
            text = self._text
            lines: Dict[int, None] = {}
            place = text.find(word) if word else -1  # an empty text is everywhere
            while place >= 0:
                end = place + len(word)
                if not (_in_word(text[place - 1 : place]) or _in_word(text[end : end + 1])):
                    lines[bisect.bisect_left(self._ends, place) + 1] = None
                place = text.find(word, end)
            self._numbers[word] = list(lines)
        return self._numbers[word]


def _in_word(character: str) -> bool:
    return character.isalnum() or character in ("_", "-")
