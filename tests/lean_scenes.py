"""Small scenes that need less than everything a model reads: what is in them, and which buffers they do not need."""

from pathlib import Path

DIFFUSE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.4, 0.2"/></bsdf>'
METAL = '<bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf>'
PLASTIC = '<bsdf type="roughplastic"><float name="alpha" value="0.2"/></bsdf>'
POINT = """<emitter type="point"><point name="position" x="1" y="2" z="4"/>
    <rgb name="intensity" value="20, 18, 15"/></emitter>"""
SKY = '<emitter type="constant"><float name="radiance" value="0.5"/></emitter>'
LAMP = """<shape type="sphere"><point name="center" x="{}" y="0" z="3"/><float name="radius" value="0.3"/>
    <emitter type="area"><float name="radiance" value="9"/></emitter></shape>"""
WALL = '<shape type="rectangle"><transform name="to_world"><scale value="9"/><translate z="-1"/></transform>{}</shape>'
BALL = '<shape type="sphere">{}</shape>'
TOUCHING = '<shape type="sphere"><point name="center" x="1.2" y="0" z="1.2"/>{}</shape>'

SPLIT = {"diffuse", "specular", "diffuse.variance", "specular.variance"}
# What is in the scene, at how many samples, and which buffers it does not need.
SCENES = {
    "diffuse under a point light": ([WALL.format(DIFFUSE), BALL.format(DIFFUSE), POINT], 2, SPLIT | {"alpha"}),
    "metal under a sky": ([BALL.format(METAL), SKY], 2, SPLIT | {"diffuse.albedo"}),
    "diffuse, the lamp out of sight": ([BALL.format(DIFFUSE), LAMP.format(8)], 2, SPLIT),
    "diffuse, the lamp in sight": ([BALL.format(DIFFUSE), LAMP.format(0.8)], 2, set()),
    "plastic": ([BALL.format(PLASTIC), POINT], 2, set()),
    "plastic before a wall": ([WALL.format(DIFFUSE), BALL.format(PLASTIC), POINT], 2, {"alpha"}),
    "one sample": ([BALL.format(PLASTIC), POINT], 1, {"diffuse.variance", "specular.variance", "variance"}),
}


def make_scene(path: Path, things: list[str]) -> Path:
    camera = """<sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="12"/>
        <rfilter type="box"/></film></sensor>"""
    path.write_text(f'<scene version="3.0.0">{camera}{"".join(things)}</scene>')
    return path
