"""The pathfold family: a U-Net at half resolution that predicts a trusted gather pyramid."""
