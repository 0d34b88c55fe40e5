"""The revisions of the index, oldest first by their numbers."""
