"""Replay of recordings to viewers."""
