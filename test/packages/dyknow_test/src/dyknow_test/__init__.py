"""Nodelets for the tests of DyKnow."""
