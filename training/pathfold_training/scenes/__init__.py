"""Scenes to train on: made in code (procedural) or read from a folder (library)."""
