#!/usr/bin/env python3
"""Records light as Cycles computes it: small scenes, and values at a few hundred points, which tests/pipeline/cycles.rs compares with.

    pip install bpy==4.2.0 OpenEXR        (Python 3.11)
    python tests/cycles/record.py [FOLDER]

For each scene Blender's exporter writes the mesh (+Y up), and NAME.csv gets a row per pixel that sees a surface: position and normal in the
space of that file, then the passes of Blender: ambient occlusion, diffuse direct and diffuse indirect, both without color. Pixels are
points: the filter is a hundredth of a pixel wide.
"""

import csv
import math
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy

FOLDER = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
WIDTH, HEIGHT = 20, 14
SAMPLES = 4096


def sky(u, v):
    """Radiance of the environment at a place of its picture, from the top left: bright on one side, as `sky` in cycles.rs."""
    side = max(0.0, math.cos(2 * math.pi * (u - 0.15))) ** 4 * math.sin(math.pi * v)
    return (0.1 + 4.0 * side, 0.2 + 3.0 * side, 0.4 + 1.0 * side)


def clear(bounces):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    scene.cycles.filter_width = 0.01
    scene.cycles.max_bounces = bounces
    scene.cycles.diffuse_bounces = bounces
    scene.cycles.sample_clamp_indirect = 0
    scene.cycles.sample_clamp_direct = 0
    scene.cycles.seed = 1
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    scene.render.resolution_percentage = 100
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
    # The rays of the pass of ambient occlusion reach as far as the scene.
    scene.world.light_settings.distance = 1000
    layer = bpy.context.view_layer
    layer.use_pass_position = layer.use_pass_normal = True
    layer.use_pass_ambient_occlusion = True
    layer.use_pass_diffuse_direct = layer.use_pass_diffuse_indirect = True
    layer.use_pass_diffuse_color = True
    return scene


def material(name, color, glow=0.0):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = 1
    shader.inputs["Specular IOR Level"].default_value = 0
    shader.inputs["Emission Color"].default_value = (1, 1, 1, 1)
    shader.inputs["Emission Strength"].default_value = glow
    made.use_backface_culling = False
    return made


def quad(name, corners, of):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [range(len(corners))])
    mesh.materials.append(of)
    bpy.context.collection.objects.link(bpy.data.objects.new(name, mesh))


def box(name, center, size, turn, of):
    bpy.ops.mesh.primitive_cube_add(size=1, location=center, rotation=(0, 0, turn))
    cube = bpy.context.object
    cube.name, cube.scale = name, size
    cube.data.materials.append(of)


def look(position, target, lens=35):
    data = bpy.data.cameras.new("Camera")
    data.lens = lens
    camera = bpy.data.objects.new("Camera", data)
    bpy.context.collection.objects.link(camera)
    camera.location = position
    direction = camera.location.copy()
    direction[:] = [t - p for t, p in zip(target, position)]
    camera.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.camera = camera


def box_on_plane(scene):
    grass, brick = material("grass", (0.3, 0.6, 0.2)), material("brick", (0.8, 0.3, 0.2))
    quad("plane", [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], grass)
    box("box", (0.3, 0.2, 1.0), (1.6, 2.0, 2.0), 0.4, brick)
    look((4.5, -6.0, 4.5), (0, 0, 0.6))


def constant_world():
    scene = clear(1)
    box_on_plane(scene)
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (1.0, 0.8, 0.6, 1)
    background.inputs["Strength"].default_value = 1
    return scene


def bright_side():
    scene = clear(1)
    box_on_plane(scene)
    width, height = 128, 64
    image = bpy.data.images.new("sky", width, height, float_buffer=True, is_data=True)
    # Blender's rows begin at the bottom.
    texels = [
        (*sky((x + 0.5) / width, 1 - (y + 0.5) / height), 1.0) for y in range(height) for x in range(width)
    ]
    image.pixels.foreach_set(numpy.array(texels, "f4").ravel())
    image.update()
    image.pack()
    tree = scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(texture.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1
    return scene


def lamp_in_box():
    scene = clear(1)
    white = material("white", (0.7, 0.7, 0.7))
    red, green = material("red", (0.6, 0.05, 0.05)), material("green", (0.1, 0.5, 0.1))
    lamp = material("lamp", (0, 0, 0), 10.0)
    quad("floor", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], white)
    quad("ceiling", [(-1, 1, 2), (1, 1, 2), (1, -1, 2), (-1, -1, 2)], white)
    quad("back", [(-1, 1, 0), (1, 1, 0), (1, 1, 2), (-1, 1, 2)], white)
    quad("left", [(-1, -1, 0), (-1, 1, 0), (-1, 1, 2), (-1, -1, 2)], red)
    quad("right", [(1, -1, 0), (1, -1, 2), (1, 1, 2), (1, 1, 0)], green)
    quad("lamp", [(-0.4, -0.3, 1.7), (-0.4, 0.3, 1.7), (0.4, 0.3, 1.7), (0.4, -0.3, 1.7)], lamp)
    box("block", (0.35, 0.1, 0.35), (0.6, 0.6, 0.7), 0.3, white)
    look((0, -5.2, 1.0), (0, 0, 1.0), 45)
    return scene


def channels(scene, folder):
    """The passes of a rendering, as arrays of rows from the top."""
    path = Path(folder) / "passes.exr"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name.split(".", 1)[1]: channel.pixels for name, channel in file.channels().items()}


def record(name, build, extension):
    scene = build()
    with tempfile.TemporaryDirectory() as folder:
        passes = channels(scene, folder)
    mesh = FOLDER / f"{name}.{extension}"
    if extension == "obj":
        bpy.ops.wm.obj_export(
            filepath=str(mesh), forward_axis="NEGATIVE_Z", up_axis="Y", export_uv=False, export_triangulated_mesh=False
        )
    else:
        bpy.ops.export_scene.gltf(
            filepath=str(mesh), export_format="GLTF_EMBEDDED" if extension == "gltf" else "GLB", export_yup=True, export_texcoords=False
        )
    take = lambda layer, parts: numpy.stack([passes[f"{layer}.{part}"] for part in parts], axis=-1)
    position, normal = take("Position", "XYZ"), take("Normal", "XYZ")
    ao = take("AO", "RGB")[..., 0]
    direct, indirect = take("DiffDir", "RGB"), take("DiffInd", "RGB")
    color = take("DiffCol", "RGB")
    rows = 0
    with open(FOLDER / f"{name}.csv", "w", newline="") as file:
        write = csv.writer(file, lineterminator="\n").writerow
        write("x y z nx ny nz ao direct_r direct_g direct_b indirect_r indirect_g indirect_b".split())
        for y, x in numpy.ndindex(HEIGHT, WIDTH):
            # Where it sees an edge all the same, normals are means of several.
            # Light over no color is not known.
            if numpy.linalg.norm(normal[y, x]) < 0.999 or color[y, x].min() < 0.01:
                continue
            turned = lambda v: (v[0], v[2], -v[1])
            values = [*turned(position[y, x]), *turned(normal[y, x]), ao[y, x], *direct[y, x], *indirect[y, x]]
            write([f"{value:.5g}" for value in values])
            rows += 1
    print(f"{name}: {rows} points")


FOLDER.mkdir(parents=True, exist_ok=True)
record("constant-world", constant_world, "obj")
record("bright-side", bright_side, "obj")
record("lamp-in-box", lamp_in_box, "glb")
# The module does not always survive the end of Python.
sys.stdout.flush()
os._exit(0)
