"""Views as training data: scenes traced, stored, checked and shown."""
