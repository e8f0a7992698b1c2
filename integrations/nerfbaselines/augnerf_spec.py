"""Registers augnerf with nerfbaselines: name this file in NERFBASELINES_REGISTER."""

import os
import sys

from nerfbaselines import register

# The class is imported by name, so its folder must be importable.
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

register({
    "id": "augnerf",
    "method_class": "augnerf_method:AugNerf",
    "backends_order": ["python"],
    "metadata": {
        "name": "augnerf",
        "description": "NeRF with and without worst-case augmentation (Aug-NeRF), trained by the program `augnerf`.",
        "paper_title": "Aug-NeRF: Training Stronger Neural Radiance Fields with Triple-Level "
                       "Physically-Grounded Augmentations",
        "paper_authors": ["Tianlong Chen", "Peihao Wang", "Zhiwen Fan", "Zhangyang Wang"],
        "licenses": [{"name": "MIT or Apache-2.0"}],
    },
    "presets": {
        # NeRF-Synthetic: poses as they are, the bounds and the box that augnerf gives this format.
        "blender": {
            "@apply": [{"dataset": "blender"}],
            "data.recentre": "false",
            "data.near": "2",
            "data.far": "6",
            "field.hash.bounds": "[[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]",
        },
        "aug-nerf": {"method": "aug-nerf"},
    },
})
