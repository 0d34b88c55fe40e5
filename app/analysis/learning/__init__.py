"""`graspwatch learn`: a tissue library from labeled recordings."""
