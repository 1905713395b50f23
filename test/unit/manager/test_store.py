# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The store: exact, and never a reason not to start."""

from __future__ import annotations

import json
import sqlite3
from functools import partial
from pathlib import Path

import pytest
from faulty_disk import kept_aside

from dyknow.errors import StoreError
from dyknow.manager.bodies import pack, unpack
from dyknow.manager.claim import Claim, Moment
from dyknow.manager.library import Library
from dyknow.manager.record import Record
from dyknow.manager.store import Store
from dyknow.model.graph import State
from dyknow.model.streams import StreamRequest
from dyknow.model.transformation import Parameter, Port, Transformation

TRANSFORMATION = Transformation(
    "a(1)",
    "pkg/A",
    "nodelet",
    7,
    (Parameter("x", "yaml", "{a: [1, 2]}"),),
    (Port("in", "in", "std_msgs/Header", ("T(a)", "ü(b)")), Port("out", "out")),
)
CLAIM = Claim(
    "c1",
    StreamRequest(
        "T(a)", min_rate=5.0, max_age=0.1, max_silence=1.0, budget=1.5, require="it.x < 3"
    ),
)
NOW = Moment(1.0, 2.0, "boot")
read_claim = partial(Claim.from_body, now=NOW)


def test_everything_reads_back_exactly(tmp_path: Path) -> None:
    path = str(tmp_path / "deep" / "state.db")
    store = Store(path)
    record = Record(
        "/n", TRANSFORMATION, "/m", True, True, False, {"in": "/t"}, State.RUNNING, claimed=True
    )
    store.write(
        {
            ("transformations", "a(1)"): pack(TRANSFORMATION),
            ("nodelets", "/n"): record.body(),
            ("claims", "c1"): CLAIM.body(NOW),
            ("facts", "revision"): "41",
        }
    )
    store.close()
    store = Store(path)
    assert store.complaint == ""
    assert Library(store).all() == [TRANSFORMATION]
    assert store.read("nodelets", Record.from_body) == {"/n": record}
    assert store.read("claims", read_claim) == {"c1": CLAIM}
    assert store.number("revision") == 41


def test_a_file_of_another_format_is_set_aside(tmp_path: Path) -> None:
    path = str(tmp_path / "state.db")
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    store = Store(path)
    assert "format 99" in store.complaint


def test_a_folder_that_cannot_be_made_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="file"):
        Store(str(tmp_path / "file" / "state.db"))


RECORD = Record("/n", TRANSFORMATION, "/m", topics={"in": "/t"}, state=State.RUNNING)
BODY = json.loads(RECORD.body())


MEANINGLESS = {
    "nodelets": [
        "no json",
        "[]",
        "[" * 100_000,
        "{}",
        *(
            json.dumps({**BODY, field: value})
            for field, value in (
                ("state", 77),
                ("topics", ["in"]),
                ("topics", {"in": 5}),
                ("manager", None),
                ("surprise", 1),
                ("transformation", '["a"]'),
                ("transformation", '["a","b/C","nodelet",1,[],[5]]'),
                ("transformation", '["a","b/C","nodelet",1,[["x","int","y"]],[]]'),
            )
        ),
    ],
    "transformations": [
        "{}",
        pack(TRANSFORMATION),  # under another label
        '["bad","b/C","nodelet","1",[],[]]',
        '["bad","b/C","nodelet",1,[["x","int",5]],[]]',
        '["bad","b/C","nodelet",1,[],[["p","in","",[5]]]]',
    ],
    "facts": ["seven"],
    "claims": ["[1, 2]", "nothing"],
}


@pytest.mark.parametrize(
    ("table", "text", "name"),
    [
        *(
            pytest.param(table, text, "", id=f"{table}-{number}")
            for table, texts in MEANINGLESS.items()
            for number, text in enumerate(texts)
        ),
        pytest.param("nodelets", RECORD.body(), "/n\x01", id="nodelets-name"),
    ],
)
def test_an_entry_that_means_nothing_is_set_aside_and_the_rest_is_used(
    tmp_path: Path, table: str, text: str, name: str
) -> None:
    path = str(tmp_path / "state.db")
    key = name or ("/bad" if table == "nodelets" else "bad")
    store = Store(path)
    store.write(
        {
            ("transformations", "a(1)"): pack(TRANSFORMATION),
            ("nodelets", "/n"): RECORD.body(),
            ("claims", "c1"): CLAIM.body(NOW),
            ("facts", "library_revision"): "3",
            (table, key): text,
        }
    )
    store.close()
    for entry_is_named in (True, False):  # once
        store = Store(path)
        library = Library(store)
        assert library.all() == [TRANSFORMATION]
        assert store.read("nodelets", Record.from_body) == {"/n": RECORD}
        assert store.read("claims", read_claim) == {"c1": CLAIM}
        assert library.revision >= 3  # the entry set aside may have been of the library
        assert (f"{table} '{key}'" in store.complaint) is entry_is_named
        store.close()
    (aside,) = kept_aside(path)
    (entry,) = json.loads(aside.read_text())
    assert (entry["table"], entry["key"], entry["text"]) == (table, key, text)
    assert entry["cause"]


def test_the_labels_are_named_whose_variables_mean_something_else_than_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = str(tmp_path / "state.db")
    single = TRANSFORMATION._replace(
        label="single", ports=(Port("in", "in", "", ("T(?x, ?x)", "T(?y)")), Port("out", "out"))
    )
    shared = TRANSFORMATION._replace(
        label="shared", ports=(Port("in", "in", "", ("T(?x)",)), Port("b", "in", "", ("U(?x)",)))
    )
    store = Store(path)
    store.write(
        {("transformations", each.label): pack(each) for each in (TRANSFORMATION, single, shared)}
    )
    warnings = []
    for _ in range(2):  # once
        Library(store)
        store.close()
        store = Store(path)
        warnings += [each.getMessage() for each in caplog.records]
        caplog.clear()
    assert len(warnings) == 1
    assert warnings[0].endswith("each tag of shared")


def test_what_earlier_versions_can_use_is_written_as_they_wrote_it() -> None:
    plain = Transformation("a", "p/A")
    assert pack(plain) == '["a","p/A","nodelet",1,[],[]]'
    assert unpack(pack(plain)) == plain
    for other in (
        Transformation("a", "p/a", "node", isolated=True),
        Transformation("a", "", "node", node="/a"),
    ):
        assert unpack(pack(other)) == other
    for wrong in ('["a","p/A","node",1,[],[],1,""]', '["a","p/A","node",1,[],[],true,1]'):
        with pytest.raises((TypeError, ValueError)):
            unpack(wrong)
