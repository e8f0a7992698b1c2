#!/usr/bin/env python3
"""Makes the font of figures: `reduce.py LiberationSans-Regular.ttf OUT.ttf` (needs fonttools).

Outlines, advances and kerning stay as they are. What figures never use goes: hints, names of glyphs, other scripts, and
features that are off unless asked for. The licence reserves the original's name, so the result has another.
"""

import sys

from fontTools import subset

NAME = "Augnerf Sans"
FAMILY, UNIQUE, FULL, POSTSCRIPT, TYPOGRAPHIC_FAMILY = 1, 3, 4, 6, 16
# Latin, Greek, Cyrillic; punctuation, raised digits, currencies; letterlike signs, arrows, mathematics, shapes.
RANGES = [(0x20, 0x52F), (0x1E80, 0x1FFE), (0x2000, 0x2BFF), (0xFB01, 0xFB02)]

source, out = sys.argv[1:]
options = subset.Options(hinting=False, notdef_outline=True, name_IDs=["*"], name_languages=["*"], layout_features=["kern"])
font = subset.load_font(source, options)
subsetter = subset.Subsetter(options)
subsetter.populate(unicodes=[code for code in font.getBestCmap() if any(a <= code <= b for a, b in RANGES)])
subsetter.subset(font)
for record in font["name"].names:
    if record.nameID in (FAMILY, UNIQUE, FULL, TYPOGRAPHIC_FAMILY):
        record.string = NAME
    elif record.nameID == POSTSCRIPT:
        record.string = NAME.replace(" ", "")
subset.save_font(font, out, options)
