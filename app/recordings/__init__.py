"""Recordings of runs: writing, listing, repair, replay and exchange."""
