"""Functions that learn tissue libraries from labeled recordings; `app.analysis.learning` reads and writes files."""
