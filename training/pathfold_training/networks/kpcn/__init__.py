"""KPCN with a path embedding: per branch a network that predicts K x K gather kernels."""
