# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The files behind the library: those of the manager's parameters, and those of packages.

A package exports ``<dyknow transformations="${prefix}/FILE.xml"/>`` and
``<dyknow ontology="${prefix}/FILE.ttl"/>``. The manager polls all of them. Transformations
that a file has lost go from the library, or are those of another file that has them too. A fault
in it is logged once, and the library stays as it was. A changed ontology changes the
transformations of templates too, so that every specification is read again then.
"""

from __future__ import annotations

import json
import math
import os
import time
import traceback
from typing import TYPE_CHECKING, Callable, Collection, Mapping, Sequence

import rospy

from dyknow.errors import BadParameter, DyKnowError
from dyknow.manager.library import Library
from dyknow.manager.store import LABELS_OF_FILES, Store
from dyknow.nodelet.loading.module_files import Stamp, stamps
from dyknow.nodelet.loading.plugins import exports
from dyknow.ros.hosting.installed import missing_here
from dyknow.ros.manager.manager_settings import ManagerSettings

if TYPE_CHECKING:
    from dyknow.manager.specifications.ontologies.ontology import Ontology

#: Seconds between two looks at the files.
LOOK_PERIOD = 1.0
#: Seconds between two crawls of ROS_PACKAGE_PATH, and how many times as long as a crawl the pause
#: is at least, so that they take little of a processor: a hundred packages take 10 ms.
CRAWL_PERIOD, _REST = 5.0, 100.0

#: In place of a path among the stored labels of files: the files that packages exported.
_EXPORTED = ""

#: Lists the paths that packages export, by attribute of ``<dyknow>``.
Exported = Callable[[], Mapping[str, Sequence[str]]]


def exported() -> dict[str, list[str]]:
    """List the files that packages on ROS_PACKAGE_PATH export, by package."""
    found: dict[str, list[str]] = {}
    for attribute, each in sorted(exports("dyknow"), key=lambda pair: pair[1].package):
        found.setdefault(attribute, []).append(str(each.file))
    return found


class PackageExports:
    """Those files, crawled for from time to time and remembered meanwhile."""

    def __init__(self, crawl: Exported = exported, clock: Callable[[], float] = time.monotonic):
        """Make it without a crawl."""
        self._crawl = crawl
        self._clock = clock
        self._found: Mapping[str, Sequence[str]] = {}
        self._next = -math.inf

    def __call__(self) -> Mapping[str, Sequence[str]]:
        """List the files by attribute, as the last crawl found them."""
        if self._clock() >= self._next:
            began = time.thread_time()
            self._found = self._crawl()
            pause = max(CRAWL_PERIOD, _REST * (time.thread_time() - began))
            self._next = self._clock() + pause
        return self._found


class LibraryFiles:
    """Follows the files that the settings name, and those that packages export.

    The store keeps the labels of files, which may lose some while no manager runs.
    """

    def __init__(self, settings: ManagerSettings, store: Store, exported: Exported) -> None:
        self._settings = settings
        self._store = store
        #: Labels by file, as they are stored.
        self._kept = store.labels_of_files()
        self._exported = exported if settings.use_exports else dict
        #: The files of the ontology that is used or refused, with their stamps.
        self._related: tuple[Sequence[str], Mapping[str, Stamp]] = ((), {})
        #: By specification file: its stamp, None if it cannot be read, and its labels; those of
        #: packages that were removed while no manager ran go at the first look.
        self._stamps: dict[str, Stamp | None] = {
            path: None
            for path in self._kept.get(_EXPORTED, ())
            if path in self._kept and not os.path.exists(path)
        }
        self._labels = {path: frozenset(self._kept[path]) for path in self._stamps}
        #: By specification file, the fault that was logged, and the stamp of the file then.
        self._said: dict[str, tuple[Stamp | None, str]] = {}

    @property
    def labels(self) -> frozenset[str]:
        """Labels of the transformations that the files have."""
        return frozenset().union(*self._labels.values())

    def ontology(self) -> Ontology | None:
        """Read the ontology at the start; None without files.

        Raises:
            BadParameter: a file that ~ontologies names cannot be used. Without one of a package,
                the other files are used.
        """
        own, paths = self._settings.ontologies, self._ontologies(self._exported())
        try:
            return self._read(paths)
        except DyKnowError as error:
            trouble = error
        try:
            found = self._read(own)
        except DyKnowError as error:
            expected = f"files that can be used; {error}"
            raise BadParameter("~ontologies", " ".join(own), expected) from error
        rospy.logerr("ontologies of packages are not used: %s", trouble)
        self._related = paths, stamps(paths)
        return found

    def look(
        self,
        library: Library,
        on_change: Callable[[Collection[str]], object] = lambda labels: None,
    ) -> float:
        """Bring a library up to date; returns the seconds until the next look.

        ``on_change`` is called after a change, with the labels that were read again.
        """
        before = library.revision
        read = self._related, dict(self._stamps)
        had = dict(self._labels)
        labels: set[str] = set()
        found = self._exported()
        is_related = self._relate(library, self._ontologies(found))
        wanted = dict.fromkeys(
            (*self._settings.transformations, *found.get("transformations", ()))
        )
        now = stamps(wanted)
        for path in wanted:
            if path in self._kept and path not in self._stamps:  # of the manager's last life
                self._stamps[path] = None
                self._labels[path] = frozenset(self._kept[path])
            is_new = path not in self._stamps or self._stamps[path] != now.get(path)
            self._stamps[path] = now.get(path)
            if is_new or is_related:
                labels |= self._add(library, path, is_new)
        for path in self._stamps.keys() - wanted.keys():
            del self._stamps[path]
            self._said.pop(path, None)
            self._forget(library, self._labels.pop(path, frozenset()))
        labels |= self._restore(library, wanted, had)
        if read != (self._related, self._stamps):
            self._keep(found.get("transformations", ()))
        if library.revision != before:
            on_change(labels)
        return LOOK_PERIOD

    def _ontologies(self, found: Mapping[str, Sequence[str]]) -> Sequence[str]:
        return tuple(dict.fromkeys((*self._settings.ontologies, *found.get("ontology", ()))))

    def _relate(self, library: Library, paths: Sequence[str]) -> bool:
        """Read the ontology again if a file has changed; returns whether there is another one."""
        known, before = self._related
        if paths == known and stamps(before.keys() | set(paths)) == before:
            return False
        try:
            library.relate(self._read(paths))
        except DyKnowError as error:
            self._related = paths, stamps(before.keys() | set(paths))
            rospy.logerr("the ontology stays as it was: %s", error)
            return False
        rospy.loginfo("read the ontology again: %s", ", ".join(paths) or "no file is left")
        return True

    def _read(self, paths: Sequence[str]) -> Ontology | None:
        if not paths:
            self._related = (), {}
            return None
        # Here: rdflib takes its time to import.
        from dyknow.manager.specifications.ontologies.ontology import Ontology

        before = stamps(paths)
        found = Ontology(
            paths, language=self._settings.language, catalogues=self._settings.catalogues
        )
        self._related = paths, {**stamps(found.files), **before}
        for warning in found.warnings:
            rospy.logwarn("%s", warning)
        return found

    def _add(self, library: Library, path: str, is_new: bool) -> frozenset[str]:
        """Read a specification file; returns the labels that it has."""
        try:
            with open(path, encoding="utf-8") as file:
                text = file.read(self._settings.limits.text_size + 1)
            found = library.add(text, path)
        except OSError as error:
            self._fails(path, f"are not added: {error.strerror or error}")
            self._stamps[path] = None  # it is tried again
            return frozenset()
        except (ValueError, DyKnowError) as error:
            self._fails(path, f"are not added: {error}")
            return frozenset()
        except Exception:  # the boundary of a file: any package may export one
            self._fails(path, f"fail:\n{traceback.format_exc()}")
            return frozenset()
        self._said.pop(path, None)
        if is_new:
            for warning in (*found.warnings, *missing_here(path, found.transformations)):
                rospy.logwarn("%s", warning)
        labels = frozenset(each.label for each in found.transformations)
        gone = self._labels.get(path, frozenset()) - labels
        self._labels[path] = labels
        self._forget(library, gone)
        return labels

    def _fails(self, path: str, how: str) -> None:
        """Log a fault, unless that was done and the file is the same."""
        said = self._stamps[path], how
        if self._said.get(path) != said:
            self._said[path] = said
            rospy.logerr("transformations of '%s' %s", path, how)

    def _restore(
        self, library: Library, paths: Collection[str], had: Mapping[str, frozenset[str]]
    ) -> set[str]:
        """Read again the files that have what another one has lost; returns their labels.

        The library may have the version that is lost. As at the start, the last file that has a
        label decides, so that files after them that share their labels are read too.
        """
        lost: set[str] = set()
        for path, labels in had.items():
            lost |= labels - self._labels.get(path, frozenset())
        found: set[str] = set()
        for path in paths:
            labels = self._labels.get(path, frozenset())
            if not lost.isdisjoint(labels):
                lost |= labels
                found |= self._add(library, path, is_new=False)
        return found

    def _keep(self, exported: Collection[str]) -> None:
        """Store the labels of the files, if they have changed."""
        labels = {path: sorted(each) for path, each in sorted(self._labels.items())}
        labels[_EXPORTED] = sorted({*exported} - {*self._settings.transformations})
        if labels != self._kept:
            self._kept = labels
            self._store.write_later({("facts", LABELS_OF_FILES): json.dumps(labels)})

    def _forget(self, library: Library, labels: Collection[str]) -> None:
        """Remove transformations that no file has any more."""
        for label in sorted(set(labels) - self.labels):
            if label in library:
                library.remove(label)
                rospy.loginfo("transformation '%s' is removed: no file has it any more", label)
