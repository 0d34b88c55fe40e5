"""Learn tissue libraries from labeled recordings: mathematics only; `app.analysis.learning` reads and writes files."""
