//! `tools/pages.py`, which writes pages from templates. Python 3 runs it.

use std::process::Command;

use crate::common::assert_says;
use crate::common::program::{Place, demand};

/// A page has its tables' numbers as its template pictures them, and a word whose condition does not hold is no page.
#[test]
fn pages_are_written_from_tables() {
    let tomllib = Command::new("python3").args(["-c", "import tomllib"]).output();
    if !tomllib.is_ok_and(|output| output.status.success()) {
        eprintln!("left out: no Python 3.11 is here to run tools/pages.py");
        return;
    }
    let place = Place::with("tools/pages.py", include_str!("../../tools/pages.py"));
    let put = |name: &str, text: &str| place.write(name, text);
    put("results/a/s/provenance.toml", "[constants]\nsteps = 8657\n");
    let table = "scene,row,axes,psnr_mean,psnr_std\nfern,NeRF,,18.9735,0.0466\nfern,+ l1 Reg.,,18.7473,0.1548\n";
    put("results/a/s/table.csv", table);
    put("results/a/s/points.csv", "id,scene,row,seed\na,fern,NeRF,0\nb,fern,NeRF,1\nc,fern,+ l1 Reg.,0\n");
    put("results/a/s/timing.csv", "id,point,seconds_training\na,,10\nb,,20\nc,,60\n");
    put("results/o/over_scenes.csv", "row,difference,p_holm,verdict\n+ TV,-0.2262,0.00004,lower\n");
    put("results/o/scenes.csv", "row,scene,difference\n+ TV,fern,1.25\n");
    let template = "{{s: psnr_mean of NeRF}} dB, {{s: steps of NeRF|0,000}} steps, {{o: difference of + TV|+0.00}} ({{o: p_holm of + TV|0e0}}), \
        {{o: difference of + TV on fern|+0.0}}, {{s: psnr_std of NeRF / psnr_std of + l1 Reg.|0 %}}, \
        {{s: seconds_training@0 of + l1 Reg. / seconds_training@0+1 of NeRF|words}} times; \
        {{loses if o: verdict of + TV is lower and p_holm of + TV < 0.05}}.\n\n\
        {{use s}}\n| row | PSNR |\n|---|---|\n| + l1 Reg. \\* | {{psnr_mean}} ± {{psnr_std|0.0}} |\n";
    let page = "18.97 dB, 8,657 steps, -0.23 (4e-5), +1.2, 30 %, four times; loses.\n\n\
        | row | PSNR |\n|---|---|\n| + l1 Reg. \\* | 18.75 ± 0.2 |\n";
    put("results/a/page.md.in", template);
    let run = |flag: &[&str], code: i32| {
        demand(Command::new("python3").arg("tools/pages.py").args(flag).current_dir(place.path()), code)
    };
    assert_says(&run(&["--check"], 1), &["results/a/page.md: not what its template makes"]);
    assert!(!place.at("results/a/page.md").exists());
    run(&[], 0);
    assert_eq!(place.text("results/a/page.md"), page);
    run(&["--check"], 0);
    for (wrong, why) in [
        (
            template.replace("is lower", "is higher"),
            "line 1: 'loses' is said, and it is not so that verdict of + TV is higher",
        ),
        (template.replace("of NeRF}} dB", "of Nerf}} dB"), "s has 0 lines of 'Nerf'"),
        (template.replace("psnr_mean of", "psnr of"), "s has no column 'psnr'"),
        (template.replace("{{use s}}", "{{use t}}"), "0 results folders are called 't'"),
        (template.replace("@0+1 of NeRF|words", "@1 of NeRF / seconds_training@0 of NeRF|words"), "several operators"),
        (
            template.replace("@0 of + l1 Reg. / seconds_training@0+1 of NeRF|words", "@0 of NeRF|words"),
            "10.0 is not nearly eight",
        ),
    ] {
        put("results/a/page.md.in", &wrong);
        assert_says(&run(&["--check"], 1), &["results/a/page.md.in", why]);
    }
}
