"""The commands for both programs. A case is a bash script in which `augnerf` is the program under test."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """One list of commands, run in an empty folder whose content is compared afterwards."""

    name: str
    script: str
    # Scenes and weights that the case needs; it is skipped without them.
    needs: tuple = ()
    # A case whose files of the old program both programs find in $OLD. If a case names itself, only the new one finds files.
    old: str = ""


# Precedes every script. $AUGNERF is the program, $DATA and $WEIGHTS are folders, $SWEEPS has the revision's sweep files.
PRELUDE = r"""
set -euo pipefail
mkdir said

# Runs the program, keeps what it says (a file a command) and expects exit code $1, or one of several (8|11).
expect() {
  local wanted=$1 code=0 said; shift
  said=said/$(printf %02d "$(ls said | wc -l)")
  "$AUGNERF" "$@" > "$said.out" 2> "$said.err" || code=$?
  { echo "exit code $code: augnerf $*"; echo "--- stdout"; cat "$said.out"; echo "--- stderr"; cat "$said.err"; } > "$said.txt"
  rm "$said.out" "$said.err"
  if [[ ! $code =~ ^($wanted)$ ]]; then cat "$said.txt" >&2; exit 1; fi
}
augnerf() { expect 0 "$@"; }

# The points of a sweep and its empty table: `sweep run` writes the points before it trains the first one, and is ended then.
points() {
  local file=$1 out; out=$(basename "$file" .toml)
  # Measured seconds of a step that a budget is made of: the old program's.
  mkdir "$out"
  if [[ -e ${OLD:-}/$out/step_seconds.json ]]; then cp "$OLD/$out/step_seconds.json" "$out"; fi
  "$AUGNERF" sweep run "$file" --out "$out" --quiet > /dev/null 2>&1 & local program=$!
  until [[ -e $out/sweep.toml ]] || ! kill -0 $program 2> /dev/null; do sleep 0.02; done
  kill -9 $program 2> /dev/null || true
  wait $program 2> /dev/null || true
  [[ -e $out/sweep.toml ]]
  rm -rf "$out/points" "$out/results"
  # 8: no scene is here. 11: no point has been trained.
  expect '8|11' sweep status "$out"
  expect '8|11' sweep collect "$out" --out "$out/results"
}
"""

# Settings of a run of about a second.
TINY = (
    "--set data.width=20 --set field.width=32 --set field.depth=4 --set field.skips=[2] --set sampling.coarse=8 --set sampling.fine=8"
    " --set train.rays=64 --set train.chunk=16 --set train.steps=20 --set train.learning_rate=5e-3 --set train.precrop_steps=3"
    " --set train.log_every=4 --set train.checkpoint_every=10 --set eval.pictures=1 --set perturb.injection_layer=2"
)

# Scenes: arguments and needs.
SCENES = {
    "builtin": ("--preset smoke --set data.test_skip=4", ()),
    "builtin-forward": ("--preset smoke --set data.kind=builtin-forward --set data.test_skip=2", ()),
    "fern": ("--data $DATA/nerf_llff_data/fern --preset smoke --set data.test_skip=3", ("fern",)),
    "chair": ("--data $DATA/nerf_synthetic/chair --preset smoke --set data.test_skip=100", ("chair",)),
}
# The released code's settings for forward-facing scenes and for others.
RELEASED = {"builtin": "blender", "builtin-forward": "llff", "fern": "llff", "chair": "blender"}

METHODS = {
    "nerf": "",
    "aug-nerf-paper": "--method aug-nerf",
    "aug-nerf-calibrated": "--method aug-nerf --set perturb.attack=calibrated",
    "mip-nerf": "--method mip-nerf",
    "aug-mip-nerf": "--method aug-mip-nerf --set perturb.attack=calibrated",
}

TERM = "--set regularizer.points_per_step=256 --set regularizer.kind="
AUG = "--method aug-nerf --set perturb.attack=calibrated"
# One or two settings of a run on the built-in scene.
VARIANTS = {
    "tv": TERM + "tv --set regularizer.weight=1e-4",
    "laplacian": TERM + "laplacian --set regularizer.weight=1e-6",
    "l1": TERM + "l1 --set regularizer.weight=1e-3",
    "default-weights": TERM + "'[\"tv\",\"l1\",\"laplacian\"]'",
    "two-terms": TERM + "'[\"tv\",\"l1\"]' --set 'regularizer.weight=[1e-4,1e-3]' --set regularizer.fields=fine",
    "full-lattice": TERM + "tv --set regularizer.points=full --set regularizer.lattice=8",
    "midpoints": TERM + "laplacian --set regularizer.jitter=false --set regularizer.domain=[[-0.5,-1,-1],[1,1,0.5]]",
    "aug-nerf-tv": AUG + " " + TERM + "tv --set regularizer.weight=1e-4",
    "gaussian": AUG + " --set perturb.kind=gaussian",
    "uniform": AUG + " --set perturb.kind=uniform",
    "fresh-jitter": AUG + " --set perturb.kind=fresh-jitter",
    "mip-gaussian": "--method aug-mip-nerf --set perturb.kind=gaussian",
    "mip-fresh-jitter": "--method aug-mip-nerf --set perturb.kind=fresh-jitter",
    "coordinates": AUG + " --set perturb.feature.passes=off --set perturb.rgb.passes=off --set perturb.density.passes=off",
    "feature": AUG + " --set perturb.t.passes=off --set perturb.xyz.passes=off --set perturb.view.passes=off"
    " --set perturb.rgb.passes=off --set perturb.density.passes=off --set perturb.feature.steps=3",
    "output": AUG + " --set perturb.t.passes=off --set perturb.xyz.passes=off --set perturb.view.passes=off"
    " --set perturb.feature.passes=off",
    "passes": AUG + " --set perturb.t.passes=coarse --set perturb.feature.passes=fine --set perturb.density.passes=coarse",
    "norms": AUG + " --set perturb.xyz.norm=linf --set perturb.feature.norm=l2 --set perturb.rgb.norm=l2",
    "random-start": AUG + " --set perturb.t.steps=0 --set perturb.feature.steps=0 --set perturb.xyz.epsilon=0",
    "released-parts": AUG + " --set perturb.objective=released --set perturb.lambda=0.25 --set perturb.output=before"
    " --set perturb.perturb_last=true --set perturb.xyz_radius=released --set perturb.step_unit=relative",
    "separate": AUG + " --set perturb.field=separate --set perturb.resample=perturbed",
    "coarse-only": AUG + " --set sampling.fine=0",
    "mip-own": "--method mip-nerf --set sampling.resample_padding=0.02 --set train.coarse_weight=0.3"
    " --set train.warmup_share=0.2 --set field.rgb_padding=0.01",
    "field": "--set field.init=torch --set field.density_activation=softplus --set field.rgb_padding=0.01 --set field.skips=[1,3]"
    " --set field.view_octaves=3",
    "sampling": "--set sampling.jitter=false --set sampling.density_noise=0.5",
    "rate": "--set train.schedule=log-linear --set train.warmup_share=0.2 --set train.coarse_weight=0.5",
    "all-images": "--set train.batching=all-images --set train.decay_steps=10 --set train.decay_rate=0.5",
    "evaluations": "--set train.eval_every=7 --set train.checkpoint_every=6 --set train.keep_checkpoints=3 --set eval.chunk=100",
    "surface": "--set eval.mesh.resolution=16 --set eval.mesh.threshold=0.5 --set eval.mesh.points=2000",
    "scene": "--set data.background=black --set data.pixel_origin=centre --set data.near=1.5 --set data.far=6 --seed 7",
    "gaussian-noise": "--set data.corruption.kind=gaussian-noise",
    "shot-noise": "--set data.corruption.kind=shot-noise --set data.corruption.severity=2",
    "pepper": "--set data.corruption.kind=pepper",
    "poses": "--set data.corruption.kind=poses",
}

# Settings of the user's own scenes, and needs.
SCENE_VARIANTS = {
    "fern-world": ("--data $DATA/nerf_llff_data/fern --preset smoke --set data.ndc=false --set data.test_skip=3", "fern"),
    "fern-spherify": ("--data $DATA/nerf_llff_data/fern --preset smoke --set data.spherify=true --set data.ndc=false"
                      " --set data.holdout=10 --set data.bound_factor=0", "fern"),
    "chair-corrupted": ("--data $DATA/nerf_synthetic/chair --preset smoke --set data.test_skip=100 --set data.background=black"
                        " --set data.corruption.kind=gaussian-noise", "chair"),
    "fox": ("--data fox --preset smoke --set data.test_skip=3", "fox"),
}

# The published capture lists more frames than it has images.
FOX = r"""
expect 3 data check $DATA/fox
mkdir fox
ln -s $DATA/fox/images fox/images
python3 - "$DATA/fox" << 'END'
import json, pathlib, sys
source = pathlib.Path(sys.argv[1])
capture = json.loads((source / "transforms.json").read_text())
capture["frames"] = [frame for frame in capture["frames"] if (source / frame["file_path"]).exists()][:12]
pathlib.Path("fox/transforms.json").write_text(json.dumps(capture))
END
augnerf data check fox --set data.width=32 --quiet
"""

SWEEP = r"""
cat > tiny.toml <<'END'
title = "A tiny sweep"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1]
metrics = ["psnr", "ssim", "tv", "depth_mae", "chamfer"]
baseline = "NeRF"
combine = "one-at-a-time"

[set]
"data.width" = 16
"data.test_skip" = 4
"field.width" = 16
"sampling.coarse" = 8
"sampling.fine" = 8
"train.rays" = 32
"train.steps" = 20
"train.log_every" = 4
"eval.pictures" = 1
"eval.mesh.resolution" = 12
"eval.mesh.threshold" = 0.5
"eval.mesh.points" = 500

[[row]]
name = "NeRF"
axes = false

[[row]]
name = "Aug-NeRF"
set = { method = "aug-nerf", "perturb.attack" = "calibrated" }

[[row]]
name = "+ TV Reg."
axes = false
set = { "regularizer.kind" = "tv", "regularizer.weight" = 1e-4, "regularizer.points_per_step" = 128 }

[[axis]]
name = "steps"
panel = "features"
keys = ["perturb.feature.steps"]
values = [1, 3]

[[axis]]
name = "injection layer"
panel = "features"
keys = ["perturb.injection_layer"]
values = [1, 3]
END
"""

SHORT = "--set data.width=16 --set train.rays=32 --set train.steps=8 --set field.width=16 --set sampling.coarse=8 --set sampling.fine=8"

SWEEP_RUN = SWEEP + r"""
augnerf sweep run tiny.toml
augnerf sweep status runs/tiny
augnerf sweep collect runs/tiny --with-timing
augnerf sweep run tiny.toml
expect 2 sweep run tiny.toml --seeds 0,1,2
augnerf sweep run tiny.toml --out extended --seeds 0 --set train.steps=8 --jobs 2 --quiet
augnerf sweep run tiny.toml --out extended --seeds 0,1 --set train.steps=8 --extend --quiet
cat > budget.toml <<'END'
extends = "tiny.toml"
metrics = ["psnr"]
[[row]]
name = "NeRF, equal work"
axes = false
budget = { kind = "evaluations", like = "Aug-NeRF" }
[[row]]
name = "+ TV Reg."
remove = true
END
augnerf sweep run budget.toml --seeds 3 --name cost
augnerf sweep plan tiny.toml
"""

# A point fails, a scene is missing, a row is published.
SWEEP_GAPS = r"""
cat > gaps.toml <<'END'
title = "Gaps"
preset = "smoke"
scenes = ["builtin", "nowhere"]
seeds = [0]
metrics = ["psnr"]
[set]
"data.width" = 16
"train.steps" = 4
"train.rays" = 16
[[row]]
name = "NeRF"
[[row]]
name = "Too fast"
set = { "train.learning_rate" = 1e30 }
END
expect 7 sweep run gaps.toml
expect 7 sweep run gaps.toml --retry-failed --quiet
expect 8 sweep run gaps.toml --out missing --scenes nowhere
expect 8 sweep status missing
"""

USES = r"""
T="--preset smoke $TINY"
augnerf train --quiet --out nerf $T --set data.test_skip=4
augnerf train --quiet --out aug $T --set data.test_skip=4 --method aug-nerf --set perturb.attack=calibrated
augnerf train --quiet --out mip $T --set data.test_skip=4 --method mip-nerf
"""

# Mistakes: exit codes and messages.
REFUSALS = r"""
expect 2 train --set train.stepz=3
expect 2 train --set train.steps=0
expect 2 train --set train.steps=many
expect 2 train --set train.learning_rate=-1
expect 2 train --set method=nerv
expect 2 train --method nerv
expect 2 train --preset smok
expect 2 train --set field.width=3
expect 2 train --set field.skips=[9]
expect 2 train --set sampling.coarse=1
expect 2 train --set perturb.t.epsilon=0.9 --method aug-nerf
expect 2 train --set perturb.injection_layer=99 --method aug-nerf
expect 2 train --set perturb.t.norm=l2 --method aug-nerf
expect 2 train --set regularizer.kind=tv --method mip-nerf
expect 2 train --set regularizer.kind=tw
expect 2 train --set 'regularizer.kind=["tv","l1"]' --set 'regularizer.weight=[1]'
expect 2 train --set data.corruption.kind=gaussian-noise --set data.corruption.severity=6
expect 2 train --set eval.mesh.resolution=4
expect 2 train --set nonsense
expect 2 train --config nowhere.toml
expect 2 train --device abacus
expect 2 train --nonsense
expect 3 train --data nowhere
expect 3 train --lpips-weights nowhere
expect 2 balance --method aug-nerf
expect 2 bench --method none
expect 5 resume nowhere
expect 5 eval nowhere
expect 5 mesh nowhere
expect 5 sweep status nowhere
expect 2 sweep run nowhere.toml
mkdir full; touch full/file
expect 4 train --out full
expect 4 data export-builtin full
expect 2 data corrupt new
echo 'train.steps = 3' > a.toml
augnerf train --print-config --config a.toml
echo 'train.stepz = 3' > b.toml
expect 2 train --print-config --config b.toml
"""


def train_cases():
    """Trains twenty steps of every method on every scene, then varies one setting at a time on the built-in one."""
    for scene, (arguments, needs) in SCENES.items():
        for method, settings in METHODS.items():
            yield Case(f"train/{scene}/{method}", f"augnerf train --quiet --out run {arguments} {TINY} {settings}", needs)
        released = arguments.replace("--preset smoke", "") + f" --preset released-{RELEASED[scene]}"
        yield Case(f"train/{scene}/aug-nerf-released", f"augnerf train --quiet --out run {released} {TINY}", needs)
    builtin, _ = SCENES["builtin"]
    variants = dict(VARIANTS)
    variants |= {f"plain-{method}": f"--set field.core=plain {settings}" for method, settings in METHODS.items()}
    variants |= {f"plain-{name}": f"--set field.core=plain {VARIANTS[name]}" for name in ("tv", "laplacian", "gaussian")}
    for name, settings in variants.items():
        yield Case(f"train/variants/{name}", f"augnerf train --quiet --out run {builtin} {TINY} {settings}")
    for name, (arguments, need) in SCENE_VARIANTS.items():
        before = FOX if name == "fox" else ""
        yield Case(f"train/scenes/{name}", f"{before}augnerf train --quiet --out run {arguments} {TINY}", (need,))
    yield Case("train/lpips", f"augnerf train --quiet --out run {builtin} {TINY} --set data.width=64 --lpips-weights $WEIGHTS", ("lpips",))
    yield Case("train/aloud", f"augnerf train {builtin} {TINY} {AUG} {TERM}tv --set train.eval_every=10")
    again = f"augnerf train --quiet --out run {builtin} {TINY} {AUG}"
    resumed = "cp -r run stopped; rm -r stopped/checkpoints/step_000000020 stopped/metrics.*; augnerf resume stopped"
    yield Case("train/resumed", f"{again}; {resumed}; augnerf train --quiet --out again --config run/config.toml")


def config_cases():
    """Prints resolved settings and descriptions of scenes."""
    presets = ("smoke", "cpu", "paper-llff", "paper-blender", "released-llff", "released-blender")
    for scene, (arguments, needs) in SCENES.items():
        lines = [f"augnerf train --print-config {arguments}"]
        arguments = arguments.replace("--preset smoke", "")
        # The chair's views load slowly.
        methods = ("nerf", "aug-nerf", "mip-nerf", "aug-mip-nerf") if scene != "chair" else ("aug-nerf",)
        for preset in presets:
            for method in methods:
                lines.append(f"augnerf train --print-config --set data.width=16 {arguments} --preset {preset} --method {method}")
        yield Case(f"config/{scene}", "\n".join(lines), needs)
    yield Case("data/check", "augnerf data check\naugnerf data check --set data.kind=builtin-forward --set data.width=31")
    for scene, folder in (("fern", "nerf_llff_data/fern"), ("chair", "nerf_synthetic/chair")):
        yield Case(f"data/check-{scene}", f"augnerf data check $DATA/{folder} --set data.width=32 --quiet", (scene,))
    yield Case("data/export", "augnerf data export-builtin scene --width 16\naugnerf data check scene")
    corrupt = [f"augnerf data corrupt {kind} --set data.width=24 --set data.corruption.kind={kind}"
               for kind in ("gaussian-noise", "shot-noise", "pepper", "poses")]
    yield Case("data/corrupt", "\n".join(corrupt))


def use_cases():
    """Renders, evaluates, measures, compares, meshes and resumes runs."""
    uses = "TINY=\"" + TINY + "\"" + USES
    yield Case("render", uses + "augnerf render nerf --frames 2\naugnerf render mip --what views --out views\n")
    yield Case("eval", uses + "augnerf eval nerf\naugnerf eval aug --quiet\naugnerf eval mip\n")
    yield Case("measure", uses + "augnerf eval nerf --smoothness --lattice 12\naugnerf eval aug --smoothness --lattice 12\nexpect 2 eval mip --smoothness\n")
    yield Case("compare", uses + "augnerf compare nerf aug --box-width 8\naugnerf compare nerf aug mip --out figure --view 1"
               " --zoom 2,3,8,8 --label A --label B --label C\n")
    yield Case("ray", uses + "augnerf compare nerf aug mip --ray 8,8\naugnerf compare nerf --out figure --ray 3,5 --view 1\n")
    yield Case("mesh", uses + "augnerf mesh nerf --resolution 24 --threshold 0.5 --format ply,obj --density\n"
               "augnerf mesh aug --resolution 20 --threshold 0.5 --cap --largest --bbox -1,-1,-0.5,1,1,1\n"
               "augnerf mesh mip --resolution 16 --threshold 0.5 --quiet\n")
    yield Case("balance", f"augnerf train --balance=5 --preset smoke {TINY} --set regularizer.points_per_step=256")
    yield Case("bench", "\n".join(f"augnerf bench --method {method} --rays 8 --coarse 4 --fine 4 --width 8 --steps 1"
                                  for method in ("nerf", "aug", "mip", "tv", "laplacian")))
    yield Case("refusals", REFUSALS)
    fern, _ = SCENES["fern"]
    runs = "".join(f"augnerf train --quiet --out {name} {fern} {TINY} {settings}\n"
                   for name, settings in (("nerf", ""), ("mip", "--method mip-nerf")))
    yield Case("fern/uses", runs + "augnerf mesh nerf --resolution 16 --threshold 1\naugnerf mesh mip --resolution 16 --threshold 1\n"
               "augnerf compare nerf mip --ray 8,8\naugnerf compare nerf mip\naugnerf render nerf --frames 2\naugnerf eval nerf --smoothness --lattice 8\n",
               ("fern",))
    # The new program uses runs of the old one.
    yield Case("old-runs/resume", "cp -r $OLD/run run; rm -r run/checkpoints/step_000000020 run/metrics.*; augnerf resume run",
               old="train/builtin/aug-nerf-calibrated")
    yield Case("old-runs/use", "cp -r $OLD/run run; augnerf eval run; augnerf eval run --smoothness --lattice 8;"
               " augnerf mesh run --resolution 12 --threshold 0.5; augnerf compare run --ray 8,8", old="train/variants/tv")
    yield Case("old-runs/mip", "cp -r $OLD/run run; augnerf eval run; augnerf render run --frames 1", old="train/builtin/aug-mip-nerf")
    yield Case("old-runs/sweep", "cp -r $OLD/runs $OLD/tiny.toml .; augnerf sweep status runs/tiny; augnerf sweep run tiny.toml --quiet",
               old="sweep/run")


def sweep_cases(sweeps):
    """Makes the points of the definitions named `sweeps`, first without scenes, then with the available ones."""
    yield Case("sweep/run", SWEEP_RUN)
    yield Case("sweep/gaps", SWEEP_GAPS)
    for sweep in sweeps:
        points = f"points $SWEEPS/{sweep}.toml"
        for name, script, needs in ((f"points/no-data/{sweep}", points, ()),
                                    (f"points/data/{sweep}", f"export AUGNERF_DATA=$DATA; {points}", ("fern", "chair"))):
            yield Case(name, script, needs, old=name)


def all_cases(sweeps):
    """Returns every case, in the order of running."""
    return [*config_cases(), *train_cases(), *use_cases(), *sweep_cases(sweeps)]
