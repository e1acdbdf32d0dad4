"""Registers drawn sites with Open3D: register_open3d.py FOLDER [--write 60].

With `--write` the Python of this package writes the clouds of so many quiet sites of
`../measure_sites.py` as files. Without it a Python that has Open3D registers them: by
its global registration, which uses no start poses (FPFH features and RANSAC), and ICP.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
#: Size of voxels [m]; Open3D's tutorial sets all other lengths as multiples of it.
VOXEL = 0.05
#: Bounds of a pose that is not grossly wrong, as in `measure_sites.py` [m, rad].
SHIFT, TURN = 0.02, 0.01


def write(folder: Path, count: int) -> None:
    """Write clouds and true poses of quiet sites."""
    sys.path.insert(0, str(HERE.parent))
    import measure_sites

    folder.mkdir(parents=True, exist_ok=True)
    number = 0
    while count:
        scanned, words = measure_sites.drawn(number)
        if words["spoiler"] == "quiet":
            site = scanned()
            arrays = {}
            for name, surface in site.surfaces.items():
                true = np.eye(4)
                true[:3, :3] = site.stations[name].matrix
                true[:3, 3] = site.stations[name].place
                arrays[f"cloud {name}"] = surface.position[surface.usable]
                arrays[f"pose {name}"] = true
            np.savez(folder / f"{number:04d} {words['kind']}.npz", **arrays)
            count -= 1
        number += 1


def registered(cloud: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Pose of a cloud in the axes of others, by global registration and ICP."""
    import open3d

    pipeline = open3d.pipelines.registration

    def prepared(points: np.ndarray) -> tuple[Any, Any]:
        whole = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        thin = whole.voxel_down_sample(VOXEL)
        near = open3d.geometry.KDTreeSearchParamHybrid(radius=2 * VOXEL, max_nn=30)
        wide = open3d.geometry.KDTreeSearchParamHybrid(radius=5 * VOXEL, max_nn=100)
        for part in (thin, whole):
            part.estimate_normals(near)
        return (whole, thin), pipeline.compute_fpfh_feature(thin, wide)

    (source, thin), features = prepared(cloud)
    (target, other), of_other = prepared(others)
    rough = pipeline.registration_ransac_based_on_feature_matching(
        thin, other, features, of_other, True, 1.5 * VOXEL,
        pipeline.TransformationEstimationPointToPoint(False), 3,
        [pipeline.CorrespondenceCheckerBasedOnEdgeLength(0.9),
         pipeline.CorrespondenceCheckerBasedOnDistance(1.5 * VOXEL)],
        pipeline.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    fine = pipeline.registration_icp(
        source, target, 0.4 * VOXEL, rough.transformation,
        pipeline.TransformationEstimationPointToPlane(),
    )  # fmt: skip
    return np.asarray(fine.transformation)


def wrong_scans(arrays: Any) -> list[str]:
    """Names of scans that end beyond the bounds; the first scan is at its true pose."""
    names = [name.removeprefix("cloud ") for name in arrays if name.startswith("cloud")]
    wrong = []
    true = arrays[f"pose {names[0]}"]
    merged = arrays[f"cloud {names[0]}"] @ true[:3, :3].T + true[:3, 3]
    for name in names[1:]:
        cloud, true = arrays[f"cloud {name}"], arrays[f"pose {name}"]
        pose = registered(cloud, merged)
        cosine = (np.trace(pose[:3, :3].T @ true[:3, :3]) - 1) / 2
        turn = float(np.arccos(np.clip(cosine, -1, 1)))
        if np.linalg.norm(pose[:3, 3] - true[:3, 3]) > SHIFT or turn > TURN:
            wrong.append(name)
        merged = np.concatenate([merged, cloud @ pose[:3, :3].T + pose[:3, 3]])
    return wrong


def main() -> None:
    """Write the sites, or register them and print the wrong scans of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", type=int, default=0, metavar="COUNT")
    options = parser.parse_args()
    if options.write:
        write(options.folder, options.write)
        return
    sites = sorted(options.folder.glob("*.npz"))
    total = 0
    for path in sites:
        with np.load(path) as arrays:
            wrong = wrong_scans(arrays)
        total += bool(wrong)
        print(f"{path.stem}: {' '.join(wrong) or 'all right'}", flush=True)
    print(f"{total} of {len(sites)} sites have a wrong scan")


if __name__ == "__main__":
    main()
