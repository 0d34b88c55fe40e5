"""Recordings watched again: which there are, what they show, and one viewer's playing of them."""
