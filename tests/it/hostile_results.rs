//! Results' folders that were made to harm `augnerf verify`, or whoever reads what it says.

use std::fs;

use crate::common::assert_says;
use crate::common::files::{edit, rows, text};
use crate::fuzz::damage::packed;
use crate::verify::results;
use augnerf::run::DepthErrors;

/// A hundredth of its size is there: 120 kB that came to six gigabytes.
#[test]
#[ignore = "slow"]
fn packed_files_take_no_more_memory_than_large_ones() {
    let (place, folder) = results("geometry");
    fs::write(folder.join("scalars.csv.gz"), packed(&[&b"id,loss\n"[..], &b",\n".repeat(60_000_000)].concat()))
        .unwrap();
    place.says("verify", 5, &["scalars.csv.gz", "take more than 512 MiB of memory"]);
    let path = place.at("depth_errors.gz");
    // Fifty million views without a pixel.
    fs::write(&path, packed(&vec![0; 200_000_000])).unwrap();
    let error = DepthErrors::read(&path).unwrap_err().to_string();
    assert_says(&error, &["depth_errors.gz is damaged", "more than 512 MiB"]);
}

/// Twenty thousand rows that run back and forth were a curve that took 13 seconds to draw.
#[test]
fn a_log_whose_steps_fall_is_damaged() {
    let (place, folder) = results("geometry");
    fs::write(folder.join("scalars.csv.gz"), packed(b"id,step,psnr\na,10,5\na,20,6\nb,10,5\na,15,7\n")).unwrap();
    place.says("verify", 5, &["scalars.csv.gz", "point a: step 15 follows step 20"]);
}

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
