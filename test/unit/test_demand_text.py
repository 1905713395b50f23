# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags that nothing supplies: named in the text of a refusal, and read out of it again."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow.demand_text import read_missing, write_demand, write_missing
from dyknow.errors import NoPlanFound, Result, StreamRefused
from dyknow.manager.claims.answers import refusal_of
from dyknow.manager.specifications.tags import parse_tag
from dyknow.similar import did_you_mean

#: All texts that `parse_tag` reads as a name, words of the manager among them.
names = st.one_of(
    st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,5}", fullmatch=True),
    st.from_regex(r"[^(),?\s][^(),?\n\r]{0,8}[^(),?\s]", fullmatch=True),
    st.sampled_from(
        ["a; b", "a & b", "a [b/C]", "claim x", 'say "x"', "a\\", "nothing supplies x"]
    ),
).filter(lambda name: name == name.strip())
variables = names.filter(lambda name: ":" not in name).map(lambda name: "?" + name)
typed = st.builds("{}: {}".format, variables, names)
tags = st.builds(
    lambda functor, args: str(parse_tag(f"{functor}({', '.join(args)})" if args else functor)),
    names,
    st.lists(names | variables | typed, max_size=2),
)
demands = st.tuples(
    st.sets(tags, min_size=1, max_size=2), st.sampled_from(["", "std_msgs/Header"])
)
trailers = st.sampled_from(
    [
        "",
        " (excluded: camera, 'x')",
        did_you_mean("abcd", ["abce"]),
        "; no transformation is labelled 'cam'",
    ]
)


@given(st.lists(demands, min_size=1, max_size=3), trailers, st.sampled_from(["", "5d8f"]))
def test_what_is_missing_is_read_back(missing, trailer, claim_id) -> None:
    text = write_missing("Goal(x)", [write_demand(*each) for each in missing]) + trailer
    refusal = refusal_of(NoPlanFound(text, claim_id))
    assert refusal.missing == tuple(sorted(set().union(*(tags for tags, _ in missing))))
    assert refusal.given_up().missing == refusal.missing


def test_other_refusals_name_no_tags() -> None:
    for text in ("internal error", "no plan for A(b): everything that supplies it needs it first"):
        assert StreamRefused(text, Result.NO_PLAN).missing == ()
        assert read_missing(text) == ()


def test_ordinary_tags_are_written_as_they_are() -> None:
    text = write_demand(["Planes(field)", "Image(?where, left)"], "sensor_msgs/Image")
    assert text == "Image(?where, left) & Planes(field) [sensor_msgs/Image]"
