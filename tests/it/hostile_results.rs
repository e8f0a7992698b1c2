//! Results' folders that were made to harm `augnerf verify`, or whoever reads what it says.

use std::fs;

use crate::common::files::{edit, rows, text};
use crate::verify::results;

#[test]
fn scenes_and_pinned_files_of_others_are_not_touched() {
    let (place, folder) = results("geometry");
    let points = text(&folder.join("points.csv"));
    edit(&folder.join("points.csv"), ",builtin,", ",../../victim,");
    place.says("verify --update", 10, &["points.csv: line 2", "of scene '../../victim'"]);
    assert!(fs::read_dir(place.path()).unwrap().all(|entry| entry.unwrap().file_name() == "results"));
    fs::write(folder.join("points.csv"), points).unwrap();
    edit(&folder.join("provenance.toml"), "\"curves_builtin_psnr.svg\"", "\"../../victim\"");
    place.says("verify", 10, &["provenance.toml", "\"../../victim\"", "not the name of a file"]);
}

/// Names of columns were kept beside every cell: a megabyte of these came to a hundred gigabytes.
#[test]
fn columns_have_names_of_a_line() {
    let (place, folder) = results("geometry");
    let table = format!("row,{}\n{}", "x".repeat(500_000), "a,\n".repeat(200_000));
    for (name, words) in [
        // It is made again, not read.
        ("table.csv", "line 1"),
        ("points.csv", "a column's name has 500000 bytes"),
        ("timing.csv", "a column's name has 500000 bytes"),
    ] {
        let before = text(&folder.join(name));
        fs::write(folder.join(name), &table).unwrap();
        place.says("verify", 10, &[name, words]);
        fs::write(folder.join(name), before).unwrap();
    }
}

#[test]
fn numbers_that_no_point_has_are_refused() {
    for (name, column, number) in
        [("points.csv", "psnr", "nan"), ("points.csv", "ssim", "inf"), ("timing.csv", "seconds_training", "1e999")]
    {
        let (place, folder) = results("geometry");
        edit(&folder.join(name), &rows(&text(&folder.join(name)))[0][column], number);
        place.says("verify", 10, &[name, "not a finite number", number]);
    }
}
