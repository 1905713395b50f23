# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The library follows the files of parameters and packages, and no client of a stream notices."""

from __future__ import annotations

import os

import pytest
import rospy
from clocks import HandClock
from unit.manager.field import LIBRARY, Field, transformation

from dyknow.errors import BadParameter
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState
from dyknow.ros.manager import library_files
from dyknow.ros.manager.library_files import LibraryFiles
from dyknow.ros.manager.manager_settings import ManagerSettings

PREFIXES = """
@prefix : <http://x#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
"""
ONTOLOGY = f"""{PREFIXES}
:Camera a owl:Class ; rdfs:label "Camera" .
:Lens a owl:Class ; rdfs:label "Lens" .
:left a :Camera ; rdfs:label "left" .
"""
RIGHT = ':right a :Camera ; rdfs:label "right" .\n'
VIEWS = """
<transformation><label>view of ${Camera}</label><source>soccer/Camera</source>
  <args><arg label="Camera">http://x#Camera</arg></args>
  <ports><port type="out">image</port></ports>
  <tags><tag port="image">View(${Camera})</tag></tags></transformation>
"""


class Files:
    """A manager whose library comes from files in a folder."""

    def __init__(self, folder, parameters=(), ontologies=(), **settings):
        self.folder = folder
        self.exports = {"transformations": [], "ontology": []}
        self.settings = ManagerSettings(
            transformations=tuple(map(self.path, parameters)),
            ontologies=tuple(map(self.path, ontologies)),
            **settings,
        )
        self.store = Store()
        self.changes = []
        self.restart()

    def restart(self):
        """Start again as the manager does, with the same library."""
        self.files = LibraryFiles(
            self.settings,
            self.store,
            lambda: {key: [*map(self.path, files)] for key, files in self.exports.items()},
        )

    def path(self, name):
        return str(self.folder / name)

    def write(self, name, text):
        """Write a file; its time differs from that of the file before."""
        path = self.folder / name
        before = path.stat().st_mtime_ns if path.exists() else 0
        path.write_text(text)
        os.utime(path, ns=(before + 10**9, before + 10**9))

    def begin(self):
        self.field = Field(library="", ontology=self.files.ontology())
        self.look()

    def look(self):
        self.changes.clear()
        return self.files.look(self.field.manager.library, self.changes.append)

    @property
    def labels(self):
        return [each.label for each in self.field.manager.library.all()]

    @property
    def views(self):
        """The individuals that have a view."""
        return [each[len("view of ") :] for each in self.labels if each.startswith("view of ")]


def simple(*labels):
    made = (transformation(each, "soccer/Camera", "out image", "image T(x)") for each in labels)
    return f"<transformations>{''.join(made)}</transformations>"


@pytest.fixture
def files(tmp_path):
    return Files(tmp_path, ["own.xml"])


@pytest.fixture
def lab(tmp_path):
    """Of an ontology, and transformations of its individuals."""
    lab = Files(tmp_path, ["own.xml", "views.xml"], ["lab.ttl"])
    lab.write("own.xml", LIBRARY)
    lab.write("views.xml", VIEWS)
    lab.write("lab.ttl", ONTOLOGY)
    return lab


@pytest.fixture
def logged(monkeypatch):
    found = []
    monkeypatch.setattr(rospy, "logerr", lambda text, *words: found.append(text % words))
    return found


def test_files_of_parameters_and_packages_are_followed(files):
    files.write("own.xml", simple("a", "b"))
    files.begin()
    assert files.labels == ["a", "b"]
    assert (files.look(), files.changes) == (library_files.LOOK_PERIOD, [])
    files.write("package.xml", simple("c"))
    files.exports["transformations"] = ["package.xml"]
    files.look()
    assert (files.labels, files.changes) == (["a", "b", "c"], [{"c"}])
    for package, own in ((("b", "c"), ("a",)), (("c",), ("a", "b"))):
        files.write("package.xml", simple(*package))
        files.look()
        files.write("own.xml", simple(*own))
        files.look()
        assert files.labels == ["a", "b", "c"], "what another file has stays"
    files.write("own.xml", simple("b", "d"))
    files.look()
    assert (files.labels, files.changes) == (["b", "c", "d"], [{"b", "d"}])
    files.exports["transformations"] = []
    files.look()
    assert (files.labels, files.changes) == (["b", "d"], [set()])


def test_what_a_file_lost_while_no_manager_ran_goes_at_the_start(files):
    files.write("own.xml", simple("a", "b"))
    files.begin()
    files.field.manager.add_transformation(simple("by hand"))
    files.write("own.xml", simple("a", "c"))
    files.restart()
    files.look()
    assert files.labels == ["a", "by hand", "c"]
    (files.folder / "own.xml").unlink()
    files.restart()
    files.look()
    assert files.labels == ["a", "by hand", "c"], "a file that cannot be read loses nothing"
    files.settings = ManagerSettings()
    for _ in range(2):
        files.restart()
        files.look()
    assert files.labels == ["a", "by hand", "c"], "nor does one that no parameter names now"


def test_what_a_package_had_that_was_removed_while_no_manager_ran_goes_at_the_start(files):
    files.write("own.xml", simple("a"))
    files.write("package.xml", simple("b"))
    files.exports["transformations"] = ["package.xml", "own.xml"]
    files.begin()
    files.exports["transformations"] = []
    files.restart()
    files.look()
    assert files.labels == ["a", "b"], "another ROS_PACKAGE_PATH removes no package"
    files.exports["transformations"] = ["package.xml"]
    files.look()
    (files.folder / "package.xml").unlink()
    files.restart()
    files.look()
    assert files.labels == ["a", "b"], "it is exported and cannot be read"
    files.exports["transformations"] = []
    files.restart()
    files.look()
    assert files.labels == ["a"]
    files.field.manager.add_transformation(simple("b"))
    files.look()
    assert files.labels == ["a", "b"]


def test_a_label_that_a_file_loses_is_that_of_another_file(tmp_path):
    files = Files(tmp_path, ["one.xml", "two.xml"])
    files.write("one.xml", simple("a", "b"))
    files.write("two.xml", simple("a").replace("T(x)", "T(two)"))
    files.write("package.xml", simple("b").replace("T(x)", "T(package)"))
    files.exports["transformations"] = ["package.xml"]
    files.begin()

    def tags():
        return [each.ports[0].tags[0] for each in files.field.manager.library.all()]

    assert (files.labels, tags()) == (["a", "b"], ["T(two)", "T(package)"])
    files.write("two.xml", simple("c"))
    files.look()
    assert (files.labels, tags()) == (["a", "b", "c"], ["T(x)", "T(package)", "T(x)"])
    assert files.changes == [{"a", "b", "c"}]
    files.exports["transformations"] = []
    files.look()
    assert (files.labels, tags()) == (["a", "b", "c"], ["T(x)"] * 3)
    files.look()
    assert files.changes == []


def test_a_file_that_cannot_be_read_once_is_read_later(files, logged, monkeypatch):
    files.write("own.xml", simple("a"))
    errors = [OSError(5, "Input/output error"), *[PermissionError(13, "Permission denied")] * 2]

    def failing(path, *args, **options):
        raise errors.pop(0)

    monkeypatch.setattr(library_files, "open", failing, raising=False)
    files.begin()
    for _ in range(2):
        files.look()
    assert (errors, files.labels) == ([], [])
    assert ["Input" in logged[0], "Permission" in logged[1], len(logged)] == [True, True, 2]
    monkeypatch.undo()
    files.look()
    assert files.labels == ["a"]


def test_packages_are_crawled_less_often_the_longer_it_takes(monkeypatch):
    clock = HandClock()
    monkeypatch.setattr(library_files.time, "thread_time", clock.now)
    crawls = []

    def crawl():
        crawls.append(clock.now())
        clock.time += 0.1 if len(crawls) == 2 else 0.01
        return {"transformations": [str(len(crawls))]}

    exports = library_files.PackageExports(crawl, clock)
    for _ in range(40):
        assert exports() == {"transformations": [str(len(crawls))]}
        clock.time += 1.0
    assert [round(when) for when in crawls] == [0, 5, 15, 20, 25, 30, 35]


def test_exports_can_be_left_out(tmp_path):
    files = Files(tmp_path, use_exports=False)
    files.write("package.xml", simple("a"))
    files.write("x.ttl", ONTOLOGY)
    files.exports = {"transformations": ["package.xml"], "ontology": ["x.ttl"]}
    files.begin()
    assert files.labels == []


def test_a_file_that_raises_stops_no_other(files, logged, monkeypatch):
    files.write("own.xml", simple("a"))
    files.begin()
    library = files.field.manager.library
    add = library.add

    def failing(text, path):
        return add(text, path) if "good.xml" in path else {}[path]

    monkeypatch.setattr(library, "add", failing)
    files.write("bad.xml", simple("b"))
    files.write("good.xml", simple("c"))
    files.exports["transformations"] = ["bad.xml", "good.xml"]
    files.look()
    files.look()
    assert files.labels == ["a", "c"]
    (error,) = [text for text in logged if "bad.xml" in text]
    assert "KeyError" in error


def test_what_is_wrong_is_said_once_and_changes_nothing(files, logged):
    files.write("own.xml", simple("a"))
    files.begin()
    files.write("own.xml", "<transformations>")
    for _ in range(2):
        files.look()
    assert [text for text in logged if "own.xml" in text] == [logged[0]]
    assert "are not added" in logged[0]
    os.remove(files.path("own.xml"))
    for _ in range(2):
        files.look()
    assert logged[1].endswith("own.xml' are not added: No such file or directory")
    assert (len(logged), files.labels) == (2, ["a"])
    files.write("own.xml", simple("e"))
    files.look()
    assert files.labels == ["e"]


def test_an_individual_appears_and_claims_stay(lab):
    lab.begin()
    assert lab.views == ["left"]
    field = lab.field
    claims = [field.acquire(), field.acquire("View(left)")]
    field.settle(2.0)
    before = sorted(field.host.running)
    lab.write("lab.ttl", ONTOLOGY + RIGHT)
    lab.look()
    assert lab.views == ["left", "right"]
    field.settle(2.0)
    assert sorted(field.host.running) == before
    assert {field.state(each.claim.claim_id) for each in claims} == {ClaimState.ACTIVE}
    for tag in ("View(right)", "View(?which:Camera)"):
        assert field.acquire(tag).claim.topic
    field.settle(2.0)
    lab.write("lab.ttl", ONTOLOGY)
    lab.look()
    assert lab.views == ["left"]


def test_types_of_variables_follow_the_ontology(lab):
    lab.begin()
    with pytest.raises(Exception, match="Lens"):
        lab.field.acquire("View(?what:Lens)")
    lab.write("lab.ttl", ONTOLOGY + ":left a :Lens .\n")
    lab.look()
    assert lab.field.acquire("View(?what:Lens)").claim.topic


def test_an_ontology_that_becomes_wrong_is_not_used(lab, logged):
    lab.begin()
    lab.write("lab.ttl", ONTOLOGY + "nonsense")
    for _ in range(2):
        lab.look()
    assert len(logged) == 1
    assert "the ontology stays as it was" in logged[0]
    assert lab.views == ["left"]
    lab.write("lab.ttl", ONTOLOGY + RIGHT)
    lab.look()
    assert lab.views == ["left", "right"]


def test_at_the_start_a_wrong_ontology_of_a_parameter_is_an_error(lab, logged):
    for file in ("lab.ttl", "package.ttl"):
        lab.write(file, "nonsense")
    for exported in ([], ["package.ttl"]):
        lab.exports["ontology"] = exported
        with pytest.raises(BadParameter, match="'~ontologies'.*lab.ttl.*is not valid turtle"):
            lab.begin()
    lab.write("lab.ttl", ONTOLOGY)
    lab.begin()
    assert lab.views == ["left"]
    assert len(logged) == 1
    assert "of packages are not used" in logged[0]
    lab.write("package.ttl", PREFIXES + RIGHT)
    lab.look()
    assert lab.views == ["left", "right"]
