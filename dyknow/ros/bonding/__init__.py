"""Bonds as bondpy has them, one thread for all of them."""
