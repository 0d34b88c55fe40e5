"""Who did what: the journal, its hash chain, its check and its export."""
