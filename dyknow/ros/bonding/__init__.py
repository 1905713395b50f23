"""Bonds that speak the protocol of bondpy, with one thread for all of them."""
