//! What is said of command lines with unknown flags, words, commands and values.

use crate::common::program::{augnerf, demand};

#[track_caller]
fn said(line: &str) -> String {
    demand(&mut augnerf(&line.split(' ').collect::<Vec<&str>>()), 2)
}

#[test]
fn a_flag_that_is_a_setting_is_told_how_it_is_set() {
    for (line, tip) in [
        ("train --steps 100", "'--set train.steps=100'"),
        ("train --steps=100 --seed 3", "'--set train.steps=100'"),
        ("train --learning-rate 1e-3", "'--set train.learning_rate=1e-3'"),
        ("train --train.steps", "'--set train.steps=VALUE'"),
        ("sweep run a.toml --width --seeds 1", "'--set data.width=VALUE'"),
        ("train fern", "'--data fern'"),
        ("--threads 1 train", "it belongs after the command: 'augnerf train --threads'"),
    ] {
        let said = said(line);
        assert!(said.contains(tip), "{line}: {said}");
        assert!(!said.contains("-- --") && !said.contains("similar"), "{line}: {said}");
    }
}

#[test]
fn a_value_that_a_flag_cannot_have_is_told_with_those_that_it_can() {
    for (line, sentence) in [
        ("train --threads abc", "--threads abc: give a whole number from 1 to 1024"),
        ("train --threads 0", "--threads 0: give a whole number from 1 to 1024"),
        ("train --threads -2", "--threads -2: give a whole number from 1 to 1024"),
        ("train --seed -1", "--seed -1: give a whole number from 0 to 9223372036854775807"),
        ("train --seed=1.5", "--seed=1.5: give a whole number from 0 to 9223372036854775807"),
        ("sweep run a --jobs x", "--jobs x: give a whole number from 1 to 1024"),
        ("sweep run a --seeds -1", "--seeds -1: '-1' is no seed; give whole numbers such as 3, or ranges such as 0-9"),
        ("eval RUN --step x", "--step x: give a whole number from 0"),
        ("view RUN --port 70000", "--port 70000: give a whole number from 0 to 65535"),
        ("mesh RUN --threshold high", "--threshold high: give a number"),
    ] {
        assert_eq!(said(line), format!("error: {}\n", sentence.replace('=', " ")), "{line}");
    }
    assert!(said("train --lr 1e-3").contains("'--set train.learning_rate=1e-3'"));
}

#[test]
fn other_flags_are_told_what_is_alike_and_nothing_wrong() {
    assert!(said("trian").contains("'train'"));
    for (left, tip) in [
        ("chamfer", "`augnerf --help` lists"),
        ("sweep power a", "`augnerf sweep --help` lists"),
        ("sweep run a --yes", ""),
    ] {
        let said = said(left);
        assert!(said.contains(tip) && said.contains("CHANGELOG.md says what takes its place"), "{left}: {said}");
    }
    assert!(said("train --presett fast").contains("'--preset'"));
    for line in ["sweep status runs/a --rows A", "eval RUN --steps 100", "mesh A --rows 1", "train --nothing"] {
        let said = said(line);
        assert!(said.contains("unexpected argument") && !said.contains("-- --"), "{line}: {said}");
        assert!(!said.contains("it is a setting"), "{line}: {said}");
    }
}
