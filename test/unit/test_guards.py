# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Guards of several owners: they add up, and each owner has a parameter of its own."""

from __future__ import annotations

from dyknow.guards import NO_GUARDS, Guards, together
from dyknow.ros.nodelets.guard_parameters import from_parameter, guards_key, to_parameter


def test_guards_add_up():
    ours = Guards(denied_topics=("/e_stop",), string_length=100, array_length=5000)
    theirs = Guards(denied_topics=("*/cmd_vel",), read_only=True, array_length=10)
    both = Guards(("*/cmd_vel", "/e_stop"), read_only=True, string_length=100, array_length=10)
    assert together([ours, theirs]) == together([theirs, ours]) == both


def test_nobody_guards_nothing():
    assert together([]) == NO_GUARDS


def test_a_lenient_owner_lifts_nothing():
    strict = Guards(denied_topics=("/e_stop",), read_only=True, string_length=10, array_length=2)
    assert together([strict, NO_GUARDS]) == strict


def test_guards_survive_the_parameter_server():
    guards = Guards(denied_topics=("/e_stop",), read_only=True, string_length=10, array_length=2)
    assert from_parameter(to_parameter(guards)) == guards


def test_two_owners_never_share_a_parameter():
    owners = ["/a", "/a/b", "/a_b", "/a__b", "/a_sb", "/a/_b", "/a_/b", "/b/a", "/a_s", "/a/s"]
    keys = [guards_key(owner) for owner in owners]
    assert len(set(keys)) == len(owners)
    # None is in the namespace of another: setting that one would delete it.
    assert all(key.count("/") == 1 for key in keys)
