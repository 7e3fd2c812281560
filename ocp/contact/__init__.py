"""What gives way between blade and wheel."""
