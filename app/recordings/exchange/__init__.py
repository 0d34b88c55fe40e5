"""Exchange with other programs: import and export."""
