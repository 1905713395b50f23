# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A bond is that of one nodelet, and not of the next one under its name."""

from __future__ import annotations

from typing import Any

import pytest
from unit.nodelet.fakes import FakeClock, Idle, make_pool_world

from dyknow.nodelet.loader import Loader
from dyknow.ros.bonding.bond_table import DuplicateBond
from dyknow.ros.bonding.bonded import BondedNodelets


class FakeBonds:
    """Bonds that a test breaks; broken ones can be reported later."""

    def __init__(self):
        self.living = {}

    def add(self, bond_id, on_broken):
        if bond_id in self.living:
            raise DuplicateBond(bond_id)
        self.living[bond_id] = on_broken

    def remove(self, bond_id):
        self.living.pop(bond_id, None)


class Place:
    """A loader of nodelets with bonds."""

    def __init__(self, runtime):
        self.loader = Loader(runtime, lambda name, _: Idle, on_unloaded=self.unloaded)
        self.bonds: Any = FakeBonds()
        self.bonded = BondedNodelets(
            self.bonds, lambda context: self.loader.unload(context.name, context)
        )
        self.meanwhile = lambda: None

    def unloaded(self, context):
        meanwhile, self.meanwhile = self.meanwhile, lambda: None
        meanwhile()
        self.bonded.ended(context)

    def load(self):
        return self.loader.load("/n", "idle").context

    def load_bonded(self, bond_id):
        self.bonded.add(self.load(), bond_id)


@pytest.fixture
def place():
    world = make_pool_world(1, clock=FakeClock())
    yield Place(world.runtime)
    world.close()


def test_a_broken_bond_unloads_and_an_unload_breaks_the_bond(place):
    place.load_bonded("one")
    place.bonds.living.pop("one")()
    assert place.loader.list() == []
    place.load_bonded("two")
    place.loader.unload("/n")
    assert not place.bonds.living
    place.bonded.wait(10.0)  # returns at once


def test_a_nodelet_that_cannot_be_bonded_is_unloaded(place):
    place.bonds.add("one", None)
    with pytest.raises(DuplicateBond):
        place.load_bonded("one")
    assert place.loader.list() == []


def test_the_end_of_one_leaves_the_bond_of_the_next_alone(place):
    place.load_bonded("first")
    place.meanwhile = lambda: place.load_bonded("second")
    place.loader.unload("/n")
    assert list(place.bonds.living) == ["second"]
    place.bonds.living.pop("second")()
    assert place.loader.list() == []


def test_a_bond_that_breaks_late_leaves_the_next_one_alone(place):
    place.load_bonded("first")
    broken = place.bonds.living["first"]
    place.loader.unload("/n")
    place.load_bonded("second")
    broken()
    assert place.loader.list() == ["/n"]


def test_one_that_is_gone_before_it_is_bonded_leaves_the_next_one_alone(place):
    first = place.load()
    place.loader.unload("/n")
    place.load_bonded("second")
    place.bonded.add(first, "first")
    assert list(place.bonds.living) == ["second"]
