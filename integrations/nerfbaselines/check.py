"""Checks this integration on a scene: `python check.py SCENE key=value...`, with the keys of `--set`.

First it trains through nerfbaselines, with stops. The PSNR of the first training view, rendered and measured by
nerfbaselines, must be that in the run's metrics.json.

If data.recentre=false, it also calls `augnerf train` alone, on a capture that has the scene's test views. Bounds must
then be set (data.near, data.far, with hash grids field.hash.bounds), because augnerf's own depend on all listed views.
The weights of both trainings must be equal, and the PSNR of each test view must be that in the second run's
metrics.json.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from nerfbaselines import metrics
from nerfbaselines.datasets import dataset_index_select, load_dataset
from nerfbaselines.evaluation import build_evaluation_protocol

import augnerf_method
from augnerf_method import AugNerf

# LPIPS is not compared, and its networks need a download.
metrics.lpips = metrics.lpips_vgg = lambda a, b: np.zeros(a.shape[:-3])

scene, overrides = sys.argv[1], dict(argument.split("=", 1) for argument in sys.argv[2:])
info = AugNerf.get_method_info()
train, test = (load_dataset(scene, split=split, features=info["required_features"],
                            supported_camera_models=info["supported_camera_models"]) for split in ("train", "test"))
steps = AugNerf(train_dataset=train, config_overrides=overrides).get_info()["num_iterations"]
method = AugNerf(train_dataset=train, config_overrides={**overrides, "block": str(steps // 3)})
for step in range(steps):
    method.train_iteration(step)

protocol = build_evaluation_protocol("default")


def psnr_of(dataset, index):
    view = dataset_index_select(dataset, [index])
    return protocol.evaluate(protocol.render(method, view), view)["psnr"]


[mine] = json.loads((method._run / "metrics.json").read_text())["views"]
print(f"first training view: nerfbaselines {psnr_of(train, 0):.6f} dB, augnerf {mine['psnr']:.6f} dB")
if overrides.get("data.recentre") != "false":
    sys.exit()

with tempfile.TemporaryDirectory() as folder:
    folder = Path(folder)
    # The same files, but with the test views in the place of the copied training view.
    transforms, held_out = (augnerf_method._transforms(dataset) for dataset in (train, test))
    frames = [frame for frame in held_out["frames"] if frame["file_path"] in held_out["train_filenames"]]
    augnerf_method._write_scene(folder, held_out, False, test)
    (folder / "train").rename(folder / "test")
    for frame in frames:
        frame["file_path"] = frame["file_path"].replace("train/", "test/")
    augnerf_method._write_scene(folder, transforms, False, train)
    transforms["frames"] = [frame for frame in transforms["frames"] if frame["file_path"].startswith("train/")] + frames
    transforms["test_filenames"] = [frame["file_path"] for frame in frames]
    (folder / "transforms.json").write_text(json.dumps(transforms))
    arguments = method._experiment()
    arguments[arguments.index(method._scene)] = folder
    subprocess.run(method._command("train", *arguments, "--out", folder / "run", "--quiet"), check=True,
                   stdout=subprocess.DEVNULL)
    weights = [run / f"checkpoints/step_{steps:09d}/state.safetensors" for run in (method._run, folder / "run")]
    print("equal weights:", weights[0].read_bytes() == weights[1].read_bytes())
    differences = []
    own = {view["name"]: view["psnr"] for view in json.loads((folder / "run/metrics.json").read_text())["views"]}
    for index, frame in enumerate(frames):
        psnr = psnr_of(test, index)
        [mine] = [value for name, value in own.items() if name.endswith(Path(frame["file_path"]).stem)]
        differences.append(abs(psnr - mine))
        print(f"{Path(test['image_paths'][index]).name}: nerfbaselines {psnr:.6f} dB, augnerf {mine:.6f} dB")
    print(f"largest difference: {max(differences):.6f} dB")
