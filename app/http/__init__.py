"""How requests arrive, and how errors go back."""
