"""Ready-made scenes, made cheaper."""

from dataclasses import replace

from sim.scene import Scene


def small(scene: Scene) -> Scene:
    """The same view on a quarter of the pixels."""
    m = scene.camera.matrix
    matrix = ((m[0][0] / 2, 0.0, m[0][2] / 2), (0.0, m[1][1] / 2, m[1][2] / 2), m[2])
    camera = replace(scene.camera, width=320, height=240, matrix=matrix)
    return replace(scene, camera=camera, timing=replace(scene.timing, height=240, row_time_s=None))
