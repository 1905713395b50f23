# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The cheapest way to a stream, from the library and the running nodelets.

From the bottom: `problem` has the values that go in and out, `patterns` are tags with numbered
variables, and a `library` has transformations as actions, indexed by their supplies. It is a
value that any thread may search while the next one replaces it. A `request` adds the running
nodelets, and every cost for this client.

The way of a request through `planner`::

    reach        the part of the library behind the goal, and its least costs, without bindings
      │
    search       the cheapest tree of instances, begun at the goal: names that are bound are
      │          passed on to the next in-port
      │
    improvement  shared parts once, within the budget: the search again, for all that a cheaper
      │          plan can have, a bound, and an exact search
      │
    planner      a plan with its cost and bound; or reasons, why there is none

Reach, search and improvement work on one kind of graph, the `and_or_graph`, whose nodes and
instances are numbers. Where nodelets can be connected elsewhere, `request.matched` gives them to
the instances that they fit.

`explanation` writes the plan for people.
"""
