"""The audit trail: the journal's chain, its check and export, and who asked for what from where."""
