"""Which spp and method reach an error at the least cost, predicted from measured scenes."""
