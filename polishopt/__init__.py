"""polishopt."""
