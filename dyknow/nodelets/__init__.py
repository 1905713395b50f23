"""Nodelets that come with DyKnow, useful as they are and small enough to copy from."""
