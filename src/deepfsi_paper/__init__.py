"""The experiments of Lu and Velten, *Deep Feature-specific Imaging*, and ours beside them."""
