"""The networks: a folder for each family, what they share, and the protocol by which the training tools ask them."""
