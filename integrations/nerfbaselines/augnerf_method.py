"""The nerfbaselines method `augnerf`: it writes files, and runs the program of that name for all computation."""

import csv
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from nerfbaselines import Method, MethodInfo, ModelInfo, camera_model_to_int

# Settings of this wrapper, which are no settings of augnerf.
OWN = {"preset": "fast", "method": "nerf", "seed": "0", "device": "cpu", "threads": "", "block": "1000"}
# Settings of every run. `checkpoint_every` is set for each call of the program.
FIXED = {"data.name": "nerfbaselines", "data.kind": "transforms", "data.split": "own", "data.downscale": "1",
         "eval.pictures": "0", "eval.train_views": "0", "train.keep_checkpoints": "100",
         "train.checkpoint_minutes": "0"}
# Those of them that a checkpoint does not fix.
FREE = {"device", "threads", "block"}
# The other methods of augnerf render from the training images, which checkpoints do not hold.
METHODS = ("nerf", "aug-nerf", "mip-nerf", "aug-mip-nerf")
POLL_SECONDS = 0.05


def _opengl(pose):
    """Returns a 4x4 matrix with the axes right, up, back, from nerfbaselines's right, down, ahead."""
    matrix = np.eye(4)
    matrix[:3, :4] = np.asarray(pose, np.float64)[:3, :4]
    matrix[:3, 1:3] *= -1
    return matrix


def _lens(camera):
    """Returns the keys of a pinhole lens, which a transforms.json and a camera_path.json share."""
    if int(camera.camera_models) != camera_model_to_int("pinhole"):
        raise ValueError("augnerf reads pinhole cameras only: let nerfbaselines undistort the images")
    (fl_x, fl_y, cx, cy), (w, h) = camera.intrinsics.tolist(), camera.image_sizes.tolist()
    return {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy, "w": w, "h": h}


def _transforms(dataset):
    """Returns a dataset's cameras as a transforms.json. augnerf measures held-out views after training, and a
    method is given none, so that a copy of the first training view takes their place."""
    def frame(index, folder):
        written = {"file_path": f"{folder}/{index:05d}.png", **_lens(dataset["cameras"][index]),
                   "transform_matrix": _opengl(dataset["cameras"].poses[index]).tolist()}
        if dataset.get("masks") is not None:
            written["mask_path"] = f"masks/{index:05d}.png"
        return written
    train, held_out = [frame(index, "train") for index in range(len(dataset["cameras"]))], [frame(0, "held_out")]
    return {"frames": train + held_out, "train_filenames": [frame["file_path"] for frame in train],
            "test_filenames": [frame["file_path"] for frame in held_out]}


def _is_transparent(dataset):
    return any(image.ndim == 3 and image.shape[2] == 4 and image[..., 3].min() < 255 for image in dataset["images"])


def _background(dataset):
    """Returns the colour behind transparent pixels. nerfbaselines takes black if a dataset names none."""
    colour = dataset["metadata"].get("background_color")
    levels = {0} if colour is None else set(np.asarray(colour).tolist())
    if levels not in ({0}, {255}) and _is_transparent(dataset):
        raise ValueError(f"background {colour}: augnerf composites on black or white only")
    return "white" if levels == {255} else "black"


def _write_scene(folder, transforms, transparent, dataset=None):
    """Writes a scene that augnerf reads. Without a dataset its images are blank. That is enough for rendering, where
    images only tell augnerf whether there is a background, and is read sooner."""
    if dataset is not None and dataset["metadata"].get("color_space", "srgb") != "srgb":
        raise ValueError("augnerf trains on 8-bit sRGB images: the dataset has linear colours")
    for frame in transforms["frames"]:
        index, (w, h) = int(Path(frame["file_path"]).stem), (frame["w"], frame["h"])
        written = {"file_path": np.zeros((h, w, 4 if transparent else 3), np.uint8),
                   "mask_path": np.full((h, w), 255, np.uint8)}
        if dataset is not None:
            written["file_path"] = dataset["images"][index][:h, :w]
            if "mask_path" in frame:
                written["mask_path"] = dataset["masks"][index][:h, :w].astype(bool).astype(np.uint8) * 255
        for key in written.keys() & frame.keys():
            path = folder / frame[key]
            path.parent.mkdir(parents=True, exist_ok=True)
            if written[key].dtype != np.uint8:
                raise ValueError(f"images of type {written[key].dtype}: augnerf trains on 8-bit images")
            Image.fromarray(written[key]).save(path)
    (folder / "transforms.json").write_text(json.dumps(transforms))


def _no_program(error):
    return RuntimeError(f"{error.filename}: no such program; put augnerf on the PATH, or name it in AUGNERF")


class _Server:
    """A run that `augnerf render --serve` holds open. If this process ends, its input ends, and it ends, too."""

    def __init__(self, command, folder):
        self._folder, self._log, self._asked = folder, tempfile.TemporaryFile("w+"), 0
        try:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log,
                                             text=True)
        except FileNotFoundError as error:
            raise _no_program(error) from None
        self._read()

    def ask(self, request):
        """Renders an image, and returns its files by output."""
        try:
            print(json.dumps(request), file=self._process.stdin, flush=True)
        except BrokenPipeError:
            pass  # It has ended. Its log says why.
        number, self._asked = self._asked, self._asked + 1
        answer = self._read()
        # A call that was interrupted leaves its answer behind.
        while answer["request"] != number:
            answer = self._read()
        return {output: self._folder / name for output, name in answer["files"].items()}

    def close(self):
        self._process.terminate()
        self._process.communicate()
        self._log.close()

    def _read(self):
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            self._log.seek(0)
            raise RuntimeError(f"augnerf render: {self._log.read().strip()}")
        answer = json.loads(line)
        if "error" in answer:
            raise RuntimeError(f"augnerf render: {answer['error']}")
        return answer


class AugNerf(Method):
    def __init__(self, *, checkpoint=None, train_dataset=None, config_overrides=None):
        self._temporary, self._server = tempfile.TemporaryDirectory(prefix="augnerf-"), None
        root = Path(self._temporary.name)
        self._scene, self._blank, self._run, self._checkpoint = root / "scene", root / "blank", root / "run", checkpoint
        overrides = {key: str(value) for key, value in (config_overrides or {}).items()}
        if checkpoint is None:
            if train_dataset is None:
                raise ValueError("augnerf needs a checkpoint or a train dataset")
            self._own = {key: overrides.pop(key, value) for key, value in OWN.items()}
            if self._own["method"] not in METHODS:
                raise ValueError(f"method={self._own['method']}: choose one of {', '.join(METHODS)}")
            self._settings = {**FIXED, "data.background": _background(train_dataset), **overrides}
            transforms, transparent = _transforms(train_dataset), _is_transparent(train_dataset)
        else:
            saved = json.loads((Path(checkpoint) / "nerfbaselines.json").read_text())
            self._settings, free = saved["settings"], {key: overrides.pop(key) for key in FREE & overrides.keys()}
            self._own = {**saved["own"], **free}
            for key, value in overrides.items():
                if {**self._own, **self._settings}.get(key) != value:
                    raise ValueError(f"{key}={value}: the checkpoint keeps its own settings; train anew to change it")
            transforms, transparent = saved["transforms"], saved["transparent"]
            if (Path(checkpoint) / "run").exists():
                shutil.copytree(Path(checkpoint) / "run", self._run)
        self._transforms, self._transparent, self._can_train = transforms, transparent, train_dataset is not None
        _write_scene(self._blank, transforms, transparent)
        if train_dataset is not None:
            _write_scene(self._scene, transforms, transparent, train_dataset)
        if checkpoint is None:
            train = json.loads(self._call("train", *self._experiment(), "--print-config", "--json"))["train"]
            self._size = {"num_iterations": train["steps"], "batch_size": train["rays"]}
        else:
            self._size = saved["size"]
        self._step = self._loaded_step = self._trained_steps()
        self._block = int(self._own["block"])

    @classmethod
    def get_method_info(cls):
        return MethodInfo(method_id="", required_features=frozenset(("color",)),
                          supported_camera_models=frozenset(("pinhole",)), can_resume_training=True,
                          supported_outputs=("color", "depth", "accumulation"))

    def get_info(self):
        return ModelInfo(**self.get_method_info(), **self._size, hparams={**self._own, **self._settings},
                         loaded_step=self._loaded_step if self._checkpoint else None,
                         loaded_checkpoint=self._checkpoint)

    def train_iteration(self, step):
        """Counts a step. The program trains all counted steps at the end of a block, or before what needs them."""
        if not self._can_train:
            raise ValueError("augnerf trains only with a train dataset: this method was loaded without")
        self._step = step + 1
        if self._step % self._block != 0 and self._step != self._size["num_iterations"]:
            return {}
        self._catch_up()
        return self._metrics()

    def render(self, camera, *, options=None):
        self._catch_up()
        if self._step == 0:
            raise ValueError("augnerf renders after the first training step")
        camera = camera.item()
        files = self._serving().ask({"camera_to_world": _opengl(camera.poses).ravel().tolist(), **_lens(camera),
                                     "outputs": ["rgb.png", "depth.npy", "accumulation.npy"], "name": "image"})
        # Metrics are of 8-bit colours, as those of augnerf are.
        return {"color": np.asarray(Image.open(files["rgb.png"]), np.float32) / 255,
                "depth": np.nan_to_num(np.load(files["depth.npy"])),
                "accumulation": np.load(files["accumulation.npy"])}

    def save(self, path):
        """Writes the run's newest checkpoint and the cameras. The images stay with the dataset."""
        self._catch_up()
        run, path = Path(path) / "run", Path(path)
        path.mkdir(parents=True, exist_ok=True)
        if self._step > 0:
            shutil.copytree(self._run / "checkpoints", run / "checkpoints")
            for name in ("config.toml", "scene.json"):
                shutil.copy(self._run / name, run / name)
        saved = {"own": self._own, "settings": self._settings, "size": self._size,
                 "transforms": self._transforms, "transparent": self._transparent}
        (path / "nerfbaselines.json").write_text(json.dumps(saved))

    def close(self):
        self._stop_serving()
        self._temporary.cleanup()

    def _serving(self):
        """Returns the server of the run, which is started for the first image after a training."""
        if self._server is None:
            folder = Path(tempfile.mkdtemp(dir=self._temporary.name))
            command = self._command("render", self._run, "--data", self._blank, "--serve", "--out", folder, "--quiet")
            self._server = _Server(command, folder)
        return self._server

    def _stop_serving(self):
        """Ends the server, whose weights a training makes old."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def _experiment(self):
        """Returns the arguments of `augnerf train`."""
        named = [f"--{key}={self._own[key]}" for key in ("preset", "method", "seed")]
        return ["--data", self._scene, *named, *(f"--set={key}={value}" for key, value in self._settings.items())]

    def _command(self, *arguments):
        hardware = [f"--{key}={self._own[key]}" for key in ("device", "threads") if self._own[key]]
        return [os.environ.get("AUGNERF", "augnerf"), *map(str, arguments), *hardware]

    def _call(self, *arguments):
        try:
            done = subprocess.run(self._command(*arguments), stdin=subprocess.DEVNULL, capture_output=True, text=True)
        except FileNotFoundError as error:
            raise _no_program(error) from None
        if done.returncode != 0:
            raise RuntimeError(f"augnerf {arguments[0]}: {done.stderr.strip()}")
        return done.stdout

    def _checkpoints(self):
        """Returns the run's checkpoints by their step."""
        return {int(folder.name[5:]): folder for folder in self._run.glob("checkpoints/step_*")}

    def _trained_steps(self):
        return max(self._checkpoints(), default=0)

    def _catch_up(self):
        """Trains up to the counted step. The program's settings stay those of the full training. It writes a
        checkpoint at that step and is stopped after it. `augnerf resume` continues with equal bytes."""
        step, last = self._step, self._step == self._size["num_iterations"]
        if step == self._trained_steps():
            return
        if step < self._trained_steps():
            raise ValueError(f"step {step} is due, but {self._trained_steps()} steps were trained: steps only go up")
        self._stop_serving()
        every = "train.checkpoint_every"
        if not self._run.exists():
            command = ["train", *self._experiment(), f"--set={every}={step}", "--out", self._run]
        else:
            config = self._run / "config.toml"
            lines = [f"checkpoint_every = {step}" if line.startswith("checkpoint_every = ") else line
                     for line in config.read_text().splitlines()]
            config.write_text("\n".join(lines) + "\n")
            command = ["resume", self._run, "--data", self._scene]
        with open(Path(self._temporary.name) / "log", "w+") as log:
            process = subprocess.Popen(self._command(*command, "--quiet"), stdin=subprocess.DEVNULL,
                                       stdout=log, stderr=log)
            try:
                while process.poll() is None and (last or step not in self._checkpoints()):
                    time.sleep(POLL_SECONDS)
            finally:
                process.terminate()
                process.wait()
            log.seek(0)
            if step not in self._checkpoints() or last and process.returncode != 0:
                raise RuntimeError(f"augnerf {command[0]} ended before step {step} was done: {log.read().strip()}")
        for other, folder in self._checkpoints().items():
            if other != step:
                shutil.rmtree(folder)

    def _metrics(self):
        """Returns the newest logged training metrics."""
        with open(self._run / "scalars.csv", newline="") as file:
            rows = [row for row in csv.DictReader(file) if int(row["step"]) <= self._step]
        return {key: float(rows[-1][key]) for key in ("loss", "psnr", "learning_rate") if rows and rows[-1].get(key)}
