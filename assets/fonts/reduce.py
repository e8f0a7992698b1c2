#!/usr/bin/env python3
"""Makes the face that figures are lettered in: `reduce.py Ubuntu-Light.ttf OUT.ttf` (needs fonttools).

Every character, outline, advance and kerning pair stays; what figures never use goes: hints, the tables of hinted
widths, names of glyphs, features that are off unless asked for. The name follows section 2(c) of the font's licence.
"""

import sys

from fontTools import subset

WORK = "derivative augnerf"
FAMILY, UNIQUE, FULL, POSTSCRIPT, TYPOGRAPHIC_FAMILY = 1, 3, 4, 6, 16

source, out = sys.argv[1:]
options = subset.Options(hinting=False, notdef_outline=True, name_IDs=["*"], name_languages=["*"])
font = subset.load_font(source, options)
subsetter = subset.Subsetter(options)
subsetter.populate(unicodes=font.getBestCmap())
subsetter.subset(font)
for record in font["name"].names:
    if record.nameID in (FAMILY, UNIQUE, FULL, TYPOGRAPHIC_FAMILY):
        record.string = f"{record} {WORK}"
    elif record.nameID == POSTSCRIPT:
        # Without spaces, as the format wants it.
        record.string = f"{record}-{WORK.replace(' ', '-')}"
subset.save_font(font, out, options)
