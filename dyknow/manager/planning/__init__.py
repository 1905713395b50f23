"""The cheapest way to a stream, from what can run and what does run."""
