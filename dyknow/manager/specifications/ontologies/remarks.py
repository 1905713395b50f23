# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Warnings about an ontology: skipped statements and doubtful names, with file and line.

rdflib does not keep lines, so they are searched: the nearest place after a mention of the term
where the construct is named.
"""

from __future__ import annotations

import bisect
import re
from collections import defaultdict
from typing import NamedTuple, Sequence

import rdflib

from dyknow.errors import Problem
from dyknow.manager.specifications.ontologies.files import OntologyFile, OntologyFiles
from dyknow.manager.specifications.ontologies.names import Labels, Naming, local_name

#: Most remarks that are listed for one file.
_LISTED = 100
#: Most URIs that one remark lists.
_URIS = 5


class _Remark(NamedTuple):
    """A warning: the term that it is about, and the word that names the construct, if any."""

    term: str
    word: str
    message: str


class Remarks:
    """The warnings about the files of an ontology."""

    def __init__(self, files: OntologyFiles) -> None:
        """Note the imports that are missing."""
        self._files = files
        self._remarks: dict[str, set[_Remark]] = defaultdict(set)
        for uri, importer in files.missing:
            message = (
                f"owl:imports of <{uri}> is not followed: no file that was named is this "
                "ontology, and no catalogue names a local file for it"
            )
            self._note(importer, uri, "imports", message)

    def unread(self, path: str, owner: str, word: str, is_in_part: bool = False) -> None:
        what = f"owl:{word}" if word else "a class expression"
        how = "read in part" if is_in_part else "not read"
        self._note(path, owner, word, f"{what} in the description of <{owner}> is {how}")

    def too_many_unions(self) -> None:
        message = "too many unions to find all superclasses that the parts of each have in common"
        self._note(self._files.files[0].path, "unionOf", "", message)

    def names(self, labels: Labels, classes: Naming, individuals: Naming) -> None:
        """Note the names that are not labels in the preferred language."""
        for label, entities in labels.dropped.items():
            for entity in entities:
                message = (
                    f"the label '{label.text}' of <{entity}> in '{label.language}' is that of "
                    f"another one too, and there is none in '{labels.language}'; it does not count"
                )
                self._note(label.file, entity, "label", message)
        unlabelled: dict[str, list[str]] = defaultdict(list)
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
            for entity in naming.unlabelled:
                unlabelled[self._home(entity)].append(entity)
        for name in classes.shared_with(individuals):
            kind = str(classes.get(name))
            message = f"'{name}' names the class <{kind}> and the individual "
            self._note(self._home(kind), kind, "", f"{message}<{individuals.get(name)}>")
        for path, entities in unlabelled.items():
            message = f"no label, so that the last part of the URI is the name: {_uris(entities)}"
            self._note(path, entities[0], "", message)

    def problems(self) -> list[Problem]:
        """Return the warnings of each file by line, those without a line last."""
        return [
            problem
            for file in self._files.files
            for problem in _placed(file, sorted(self._remarks[file.path]))
        ]

    def _note(self, path: str, term: str, word: str, message: str) -> None:
        self._remarks[path].add(_Remark(term, word, message))

    def _home(self, entity: str) -> str:
        return self._files.home(rdflib.URIRef(entity))


def _uris(entities: Sequence[str]) -> str:
    more = f" and {len(entities) - _URIS} more" if len(entities) > _URIS else ""
    return ", ".join(f"<{each}>" for each in entities[:_URIS]) + more


def _placed(file: OntologyFile, remarks: Sequence[_Remark]) -> list[Problem]:
    if not remarks:
        return []
    lines = _Lines(file.data.decode("utf-8", "replace"))
    problems = [
        Problem(file.path, lines.find(local_name(each.term), each.word), each.message)
        for each in remarks[:_LISTED]
    ]
    if len(remarks) > _LISTED:
        problems.append(Problem(file.path, 0, f"{len(remarks) - _LISTED} more such remarks"))
    return sorted(problems, key=lambda problem: (problem.line == 0, problem.line))


class _Lines:
    """Finds the lines of words in a text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._ends = [found.start() for found in re.finditer("\n", text)]
        self._known: dict[str, list[int]] = {"": []}

    def find(self, term: str, word: str) -> int:
        """Return the line of the word that follows the term soonest; else that of the term."""
        mentions, words = self._of(term), self._of(word)
        following = [
            (words[place] - mention, words[place])
            for mention in mentions
            for place in [bisect.bisect_left(words, mention)]
            if place < len(words)
        ]
        return min(following)[1] if following else next(iter(mentions), 0)

    def _of(self, word: str) -> list[int]:
        """Return the lines that have the word, not as a part of a longer one."""
        if word not in self._known:
            places = (
                found.start() for found in re.finditer(f"{re.escape(word)}(?![\\w-])", self._text)
            )
            lines = {
                bisect.bisect_left(self._ends, place) + 1
                for place in places
                if not re.match(r"[\w-]", self._text[place - 1 : place])
            }
            self._known[word] = sorted(lines)
        return self._known[word]
