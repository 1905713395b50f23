# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""ROS graph names: validity, resolution, remapping."""

from __future__ import annotations

import pytest

from dyknow import names
from dyknow.errors import BadRemapping, InvalidName


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("image", "/robot/image"),
        ("cam/image", "/robot/cam/image"),
        ("/image", "/image"),
        ("~image", "/robot/nodelet/image"),
        ("~cam/image", "/robot/nodelet/cam/image"),
        ("~/image", "/robot/nodelet/image"),
        ("image/", "/robot/image"),
        ("", "/robot"),
    ],
)
def test_names_resolve_as_in_ros(name, expected):
    assert names.resolve(name, "/robot", "/robot/nodelet") == expected
    assert names.resolve("image", "/", "/nodelet") == "/image"


@pytest.mark.parametrize(
    "name", ["1st", "_x", "a b", "a-b", "a//b", "//a", "a.b", "é", "a\n", "-", "{x}", "a~b/~"]
)
def test_what_is_no_graph_name_is_refused_and_named(name):
    with pytest.raises(InvalidName) as caught:
        names.resolve(name, "/", "/n", "topic name")
    assert caught.value.name == name
    assert "topic name" in str(caught.value)


@pytest.mark.parametrize("name", ["", "~", "/", "//", "~/", "~//x", None, 5])
def test_names_without_a_name_in_them_are_refused_by_check(name):
    with pytest.raises(InvalidName):
        names.check(name)


@pytest.mark.parametrize(
    ("name", "parent"), [("/a/b/c", "/a/b"), ("/a", "/"), ("/", "/"), ("/a/b/", "/a")]
)
def test_parent_is_the_namespace_a_name_stands_in(name, parent):
    assert names.parent(name) == parent


def test_pairs_of_a_load_request_become_global():
    sources, targets = ["image", "/in", "~out"], ["cam/image", "other", "~result"]
    assert names.pair_remappings("/robot/undistort", sources, targets, "/manager") == {
        "/manager/image": "/manager/cam/image",
        "/in": "/manager/other",
        "/robot/undistort/out": "/robot/undistort/result",
    }
    with pytest.raises(BadRemapping, match=r"3 remap_source_args but 1 remap_target_args"):
        names.pair_remappings("/n", sources, ["c"], "/")


@pytest.mark.parametrize(("source", "target"), [("a b", "c"), ("a", "c d"), ("", "c"), ("a", "")])
def test_pairs_with_bad_names_are_refused(source, target):
    with pytest.raises(InvalidName):
        names.pair_remappings("/n", [source], [target], "/")


@pytest.mark.parametrize(
    ("name", "completed"),
    [
        ("~config-path", "/ns/n/config-path"),
        ("config path", "/ns/config path"),
        ("/1//2/", "/1/2"),
        ("~/x", "/ns/n/x"),
        ("~", "/ns/n/"),
        ("/", "/"),
        ("", "/ns/"),
    ],
)
def test_parameters_may_have_names_of_any_characters(name, completed):
    assert names.complete(name, "/ns", "/ns/n") == completed
