"""The audit trail: the journal, its hash chain, its check and its export."""
