"""The buffers of a pixel, by name."""

# With their channel counts, in the order they are reported.
BUFFERS = {
    "color": 3,
    "alpha": 1,
    "diffuse": 3,
    "specular": 3,
    "diffuse.albedo": 3,
    "albedo": 3,
    "normal": 3,
    "depth": 1,
    "variance": 3,
    "diffuse.variance": 3,
    "specular.variance": 3,
}
