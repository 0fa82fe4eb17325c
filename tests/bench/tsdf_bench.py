"""Fuses the depth maps that `tsdf_bench --write FOLDER` left with Open3D's legacy ScalableTSDFVolume.

usage: OMP_NUM_THREADS=2 python tsdf_bench.py FOLDER        (needs the packages open3d or open3d-cpu, and numpy)
"""

import os
import resource
import sys
import time

import numpy as np
import open3d as o3d


def main():
    folder = sys.argv[1]
    with open(os.path.join(folder, "views.txt")) as stream:
        count, voxel_size, truncation = stream.readline().split()
        rows = [[float(word) for word in line.split()] for line in stream]
    count, voxel_size, truncation = int(count), float(voxel_size), float(truncation)
    width, height = int(rows[0][0]), int(rows[0][1])
    depths = np.fromfile(os.path.join(folder, "depths.bin"), np.float32).reshape(count, height, width)
    colors = np.fromfile(os.path.join(folder, "colors.bin"), np.uint8).reshape(count, height, width, 3)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    times = []
    for _ in range(3):
        start = time.perf_counter()
        cpu_start = time.process_time()
        volume = o3d.pipelines.integration.ScalableTSDFVolume(
            voxel_length=voxel_size, sdf_trunc=truncation,
            color_type=o3d.pipelines.integration.TSDFVolumeColorType.RGB8)
        for row, depth, color in zip(rows, depths, colors):
            # Open3D puts pixel centres at whole numbers.
            intrinsic = o3d.camera.PinholeCameraIntrinsic(width, height, row[2], row[3], row[4] - 0.5, row[5] - 0.5)
            image = o3d.geometry.RGBDImage.create_from_color_and_depth(
                o3d.geometry.Image(color), o3d.geometry.Image(depth), depth_scale=1.0, depth_trunc=1e6,
                convert_rgb_to_intensity=False)
            volume.integrate(image, intrinsic, np.array(row[6:]).reshape(4, 4))
        fused = time.perf_counter()
        mesh = volume.extract_triangle_mesh()
        times.append((time.perf_counter() - start, fused - start, time.process_time() - cpu_start))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    total, fuse, _ = sorted(times)[1]
    cpu = sorted(row[2] for row in times)[1]
    error = (np.linalg.norm(np.asarray(mesh.vertices), axis=1) - 1) / voxel_size
    print(f"Open3D {o3d.__version__} ScalableTSDFVolume, {os.environ.get('OMP_NUM_THREADS', 'all')} threads: "
          f"{total:.3f} s (median of 3, CPU {cpu:.3f}; fuse {fuse:.3f}), peak {peak - before:.0f} MiB over the depth maps and images, "
          f"{len(error)} vertices, error mean {error.mean():.4f} rms {np.sqrt((error**2).mean()):.4f} "
          f"worst {np.abs(error).max():.3f} voxels")


main()
