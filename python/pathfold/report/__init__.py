"""What a bench says: tables, plots, answers in words, and one self-contained page."""
