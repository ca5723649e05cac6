"""The bench: every method on every scene, spp and seed, measured against a reference."""
