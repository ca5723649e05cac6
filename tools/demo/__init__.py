"""The demo: one scene rendered, denoised by every method, compared."""
