"""From a trained run to a model that is shipped: graphs, manifest, card, measurements."""
