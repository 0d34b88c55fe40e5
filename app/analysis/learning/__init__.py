"""`graspwatch learn`: from labelled recordings to a tissue library."""
