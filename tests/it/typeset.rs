//! The LaTeX tables, set by a TeX engine.

use std::io::ErrorKind;
use std::path::Path;
use std::process::Command;

use crate::common::files::{copy, ending};
use crate::common::program::Place;

/// Sets tables on A4 with margins of 2 cm and returns the engine's log.
fn set(tables: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    let start = "\\documentclass[a4paper]{article}\n\\usepackage[margin=2cm]{geometry}\n\\usepackage{booktabs}\n";
    let document = format!("{start}\\begin{{document}}\n{tables}\n\\clearpage\n\\end{{document}}\n");
    std::fs::write(dir.path().join("a.tex"), document).unwrap();
    let engines: [(&str, &[&str]); 2] = [
        ("pdflatex", &["-interaction=nonstopmode", "-halt-on-error", "a.tex"]),
        ("tectonic", &["--keep-logs", "a.tex"]),
    ];
    for (engine, arguments) in engines {
        match Command::new(engine).args(arguments).current_dir(dir.path()).output() {
            Ok(output) => {
                let log = String::from_utf8_lossy(&std::fs::read(dir.path().join("a.log")).unwrap()).into_owned();
                assert!(output.status.success(), "{engine}: {log}");
                return log;
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => panic!("{engine}: {error}"),
        }
    }
    panic!("no TeX engine is installed: this test sets tables with one");
}

/// Points by which the widest box is too wide.
fn too_wide(log: &str) -> f64 {
    let boxes =
        log.split("Overfull \\hbox (").skip(1).filter_map(|rest| rest.split_once("pt").map(|(points, _)| points));
    boxes.map(|points| points.parse().unwrap()).fold(0.0, f64::max)
}

#[test]
#[ignore = "needs a TeX engine"]
fn the_tables_of_every_committed_sweep_fit_the_page() {
    let results = Path::new(env!("CARGO_MANIFEST_DIR")).join("results");
    let sweeps = ending(&results, "/points.csv");
    assert!(sweeps.len() > 20);
    for points in sweeps {
        let folder = points.parent().unwrap();
        let place = Place::new();
        copy(folder, &place.at("results"));
        place.run("verify --update --all", 0);
        let log = set(&place.text("results/table.tex"));
        assert!(too_wide(&log) <= 1.0, "{}: {log}", folder.display());
    }
    // A cell too wide is noticed.
    assert!(too_wide(&set(&"x".repeat(200))) > 100.0);
}
