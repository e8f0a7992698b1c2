#!/usr/bin/env python3
"""Makes a list of validation views from the test views of a NeRF-Synthetic scene that was published without any.

    tools/chair_val.py DATA/nerf_synthetic/chair STUDY/nerf_synthetic/chair

The new folder links to the scene's images and files, and adds transforms_val.json: the test views from the sixth on. With
data.test_skip = 10, a run with data.eval_split = "test" uses views 0, 10, ..., 190, and one with "val" uses 5, 15, ..., 195.
So no view serves both for choosing settings and for results. A scene with its own validation split does not need this.
"""
import argparse
import json
import pathlib

FIRST = 5


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    scene = arguments.scene.resolve()
    if arguments.folder.resolve() == scene:
        parser.error("name another folder: the scene's own folder stays as published")
    if (scene / "transforms_val.json").exists():
        parser.error(f"{scene} has its own validation split")
    transforms = json.loads((scene / "transforms_test.json").read_text())
    transforms["frames"] = transforms["frames"][FIRST:]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for path in scene.iterdir():
        link = arguments.folder / path.name
        if not link.is_symlink():
            link.symlink_to(path)
    (arguments.folder / "transforms_val.json").write_text(json.dumps(transforms))


main()
