# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The cheapest way to a stream, from what can run and what does run.

What is known, from the bottom: ``problem`` and ``supply`` are the values that go in and out,
``patterns`` are tags with numbered variables, ``index`` and ``heads`` find the out-ports that
supply a pattern, ``rules`` are transformations with variables, and the ``network`` has the library
in numbers. ``live_streams`` and ``stream_actions`` have what runs at the moment.

The way of a request through ``planner``::

    reach        what the goal can reach at all, downwards; in the abstract, without bindings,
      │          or specialised, and then only with names that can be joined (domains)
    unbound      what its demands cost at least, upwards, without bindings
      │
    descent      what the goal can reach again, by these costs: as far as the next search comes
      │
    knuth        the cheapest tree, upwards: instances as they are met, inputs joined (joins)
      │
    improvement  shared parts once: a bound (landmarks), an exact search (branching) and
      │          neighbourhoods, over an and_or_graph of what may be cheaper, within the budget
      │
    extraction   the answer: a plan with its cost and bound, or what is missing for one

``refinement`` has these searches. ``costs`` are those of one request, ``wishes`` charge parts,
``latency`` limits paths, ``explanation`` writes the plan for people.
"""
