"""The demonstration: camera frames through a chain of nodelets that is re-wired while it runs."""
