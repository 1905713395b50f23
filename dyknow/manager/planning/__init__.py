# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The cheapest way to a stream, from what can run and what does run.

From the bottom: `problem` has the values that go in and out, `patterns` are tags with numbered
variables, and a `library` has transformations as actions, indexed by what they supply. It is a
value that any thread may search while the next one replaces it. A `request` adds what runs at
the moment, and what everything costs this client.

The way of a request through `planner`::

    bounds       what the goal can reach, and what that costs at least, without bindings
      │
    search       the cheapest tree of instances, begun at the goal: names that are bound are
      │          passed on to the next in-port
      │
    improvement  shared parts once, within the budget: the search again, for all that a cheaper
      │          plan can have (an and_or_graph), a bound, an exact search, and neighbourhoods of
      │          the plan
      │
    planner      a plan with its cost and bound; or reasons, why there is none

`explanation` writes the plan for people.
"""
