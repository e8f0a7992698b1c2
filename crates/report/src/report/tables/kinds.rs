//! Notes of tables whose rows train in different ways: with radiance fields, or without.

use super::{Line, Table};
use crate::base::columns::{COLUMNS, CaptionRule};
use crate::report::distinct;

/// Columns of methods without fields; each contains all of the method's settings.
const OWN: [&str; 3] = ["srn", "nv", "llff"];

/// What a row of LLFF is here.
const LLFF_NOTE: &str = "LLFF is trained on the scene here: the published LLFF uses one network trained on other scenes with a \
     perceptual (VGG) loss, and that network is not obtainable; here the same architecture learns from this scene's training views \
     alone, each from its neighbours, so that its numbers are not those of the published method; a training view is \
     shown from its own planes, which saw its picture, so that train_psnr and gap say less than those of other rows";

/// Returns whether a row's method has no fields.
pub(super) fn is_without_fields(line: &Line) -> bool {
    OWN.iter().any(|column| !line.protocol(column).is_empty())
}

/// Returns the notes below a scene with rows without fields: what each of these is, and what the others share.
pub(super) fn kind_notes(lines: &[&Line]) -> Vec<String> {
    if !lines.iter().any(|line| is_without_fields(line)) {
        return Vec::new();
    }
    let labels = |holds: &dyn Fn(&Line) -> bool| {
        lines.iter().filter(|line| holds(line)).map(|line| line.label.as_str()).collect::<Vec<_>>().join(", ")
    };
    let mut notes = Vec::new();
    for column in OWN {
        let texts = distinct(lines.iter().map(|line| line.protocol(column)));
        for text in texts.into_iter().filter(|text| !text.is_empty()) {
            notes.push(format!("{}: {text}", labels(&|line| line.protocol(column) == text)));
        }
    }
    // A caption states what all lines share, a note where they differ; this is neither.
    let mut shared: Vec<(String, Vec<String>)> = Vec::new();
    for name in COLUMNS.iter().filter(|column| column.caption == CaptionRule::Always).map(|column| column.name) {
        let measured = lines.iter().filter(|line| !line.ids.is_empty());
        let texts = distinct(measured.map(|line| line.protocol(name)));
        let [one] = texts.iter().filter(|text| !text.is_empty()).collect::<Vec<_>>()[..] else { continue };
        if texts.len() > 1 {
            let of = labels(&|line| line.protocol(name) == *one);
            match shared.iter_mut().find(|(known, _)| *known == of) {
                Some((_, fields)) => fields.push(format!("{name} {one}")),
                None => shared.push((of, vec![format!("{name} {one}")])),
            }
        }
    }
    notes.extend(shared.into_iter().map(|(labels, fields)| format!("{labels}: {}", fields.join(", "))));
    notes
}

/// Returns the footnote of LLFF, if such a row is trained here.
pub(super) fn llff_note(table: &Table) -> Option<String> {
    table.lines.iter().any(|line| !line.protocol("llff").is_empty()).then(|| LLFF_NOTE.to_string())
}
