"""Writes the models and the height grid of the built-in worlds.

    pip install trimesh pycollada numpy pillow; apt install assimp-utils
    python3 generate.py

bush.ply and fountain.off are written by trimesh, bridge.dae, car.obj, car.mtl and bench.3ds by assimp, hills.png by Pillow.
"""

import subprocess

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals


def solid(mesh, colour):
    mesh.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=list(colour) + [255], name="m%02x%02x%02x" % colour))
    return mesh


def box(size, centre, colour):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return solid(mesh, colour)


def prism(outline, width, colour, across=0.0):
    """An outline in x and z, drawn along y."""
    mesh = trimesh.creation.extrude_polygon(outline, width)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    mesh.apply_translation([0, across + width / 2, 0])
    return solid(mesh, colour)


def assimp(parts, target):
    scene = trimesh.Scene(parts)
    if target.endswith(".dae"):
        # assimp says of every COLLADA file it writes that y is up.
        scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    with open("parts.glb", "wb") as file:
        file.write(scene.export(file_type="glb"))
    subprocess.run(["assimp", "export", "parts.glb", target], check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["rm", "parts.glb"], check=True)


def car():
    from shapely.geometry import Polygon

    paint, glass, rubber = (150, 40, 36), (70, 84, 96), (36, 36, 38)
    body = Polygon([(-2.1, 0.25), (2.1, 0.25), (2.1, 0.7), (1.1, 0.85), (-1.9, 0.9), (-2.1, 0.8)])
    cabin = Polygon([(-1.75, 0.9), (0.95, 0.87), (0.35, 1.42), (-1.35, 1.45)])
    parts = [prism(body, 1.78, paint), prism(cabin, 1.5, glass)]
    for x in (-1.3, 1.3):
        for y in (-0.78, 0.78):
            wheel = trimesh.creation.cylinder(0.32, 0.2, sections=20)
            wheel.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
            wheel.apply_translation([x, y, 0.32])
            parts.append(solid(wheel, rubber))
    assimp(parts, "car.obj")


def bridge():
    """Ramps of 14 deg up to a deck with 1.5 m of room under it, 3 m wide, low walls along both sides."""
    from shapely.geometry import Polygon

    stone, wall = (168, 160, 148), (140, 132, 124)
    top, deck, gap = 1.75, 0.25, 1.6
    run = top / np.tan(np.radians(14.0))
    parts = []
    for side in (-1, 1):
        outline = [(side * gap, -0.6), (side * (gap + run + 1.0), -0.6), (side * (gap + run), 0.0), (side * gap, top)]
        parts.append(prism(Polygon(outline), 3.0, stone))
        for across in (-1.5, 1.5):
            rail = [(side * gap, top), (side * (gap + run), 0.0), (side * (gap + run), 0.3), (side * gap, top + 0.3)]
            parts.append(prism(Polygon(rail), 0.15, wall, across))
    parts.append(box([2 * gap, 3.0, deck], [0, 0, top - deck / 2], stone))
    for across in (-1.5, 1.5):
        parts.append(box([2 * gap, 0.15, 0.3], [0, across, top + 0.15], wall))
    assimp(parts, "bridge.dae")


def bench():
    wood, iron = (150, 104, 62), (60, 60, 64)
    parts = [box([0.45, 1.6, 0.06], [0, 0, 0.45], wood), box([0.06, 1.6, 0.4], [-0.25, 0, 0.75], wood)]
    for y in (-0.65, 0.65):
        parts.append(box([0.4, 0.08, 0.42], [0, y, 0.21], iron))
        parts.append(box([0.08, 0.08, 0.55], [-0.25, y, 0.6], iron))
    assimp(parts, "bench.3ds")


def bush():
    random = np.random.default_rng(3)
    mesh = trimesh.creation.icosphere(2, 0.8)
    mesh.vertices *= 1.0 + 0.12 * random.standard_normal((len(mesh.vertices), 1))
    mesh.vertices[:, 2] = np.maximum(0.9 * mesh.vertices[:, 2] + 0.55, -0.2)
    shade = 0.8 + 0.4 * random.random((len(mesh.vertices), 1))
    mesh.visual.vertex_colors = np.hstack([np.clip(shade * [58, 92, 44], 0, 255), np.full_like(shade, 255)]).astype(np.uint8)
    mesh.update_faces(mesh.area_faces > 1e-6)
    mesh.remove_unreferenced_vertices()
    mesh.export("bush.ply")


def fountain():
    basin = trimesh.creation.annulus(r_min=1.5, r_max=1.8, height=0.9, sections=32)
    water = trimesh.creation.cylinder(1.5, 0.5, sections=32)
    column = trimesh.creation.cylinder(0.2, 2.2, sections=16)
    basin.apply_translation([0, 0, 0.15])
    water.apply_translation([0, 0, 0.05])
    column.apply_translation([0, 0, 0.8])
    trimesh.util.concatenate([basin, water, column]).export("fountain.off")


def gorge(x):
    """Middle and depth of the gorge: it fades out to the east, where a robot can drive down into it."""
    fade = np.clip((30.0 - x) / 22.0, 0.0, 1.0)
    return 5.0 * np.sin(x / 9.0) - 1.0, 3.0 * fade * fade * (3.0 - 2.0 * fade)


def hills():
    """70 m x 70 m, a height every 0.5 m: hills, steep mounds, a gorge, and level banks where a bridge crosses it."""
    x, y = np.meshgrid(np.linspace(-35, 35, 141), np.linspace(-35, 35, 141))
    z = 0.7 * np.sin(0.11 * x + 0.4) * np.cos(0.13 * y) + 0.25 * np.sin(0.31 * x - 0.23 * y) + 0.2 * np.cos(0.37 * y + 1.0)
    for at, height, radius in [((-14, 16), 3.2, 4.0), ((3, 22), 2.4, 3.0), ((18, 14), 3.6, 4.5), ((-24, 3), 2.2, 3.0),
                               ((8, -14), 3.0, 3.6), ((-8, -22), 2.0, 2.6), ((24, -18), 2.8, 3.6), ((-17, -12), 1.8, 2.2)]:
        z = z + height * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * radius**2))
    # Banks and approaches of the bridge are level; so is the ground of the overpass.
    middle, _ = gorge(-12.0)
    for (cx, cy), (hx, hy), level in [((-12, middle), (4.0, 9.0), 0.4), ((14.0, -24.0), (11.5, 3.0), 0.2)]:
        outside = np.hypot(np.maximum(np.abs(x - cx) - hx, 0), np.maximum(np.abs(y - cy) - hy, 0))
        share = np.clip(1.0 - outside / 6.0, 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        z = z * (1 - share) + level * share
    middle, depth = gorge(x)
    side = np.clip((np.abs(y - middle) - 2.6) / 1.5, 0.0, 1.0)
    z = z - depth * (1.0 - side * side * (3.0 - 2.0 * side))
    random = np.random.default_rng(11)
    z = z + 0.012 * random.standard_normal(z.shape)
    low, high = -5.0, 5.0
    assert low < z.min() and z.max() < high, (z.min(), z.max())
    grey = np.round((z - low) / (high - low) * 65535).astype(np.uint16)
    # The first row of the image is the largest y.
    Image.fromarray(np.flipud(grey)).save("hills.png")


for make in (car, bridge, bench, bush, fountain, hills):
    make()
