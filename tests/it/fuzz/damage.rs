//! Damage to files: bits, cuts, pieces, and numbers at which readers break.

use std::io::{Read, Write};

use augnerf::base::rng::Random;
use flate2::{Compression, Crc, read::GzDecoder, write::GzEncoder};

/// Integers at which lengths and counts break.
const INTEGERS: [u64; 9] = [0, 1, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1_000_000_000_000, i64::MAX as u64, u64::MAX];
/// Numbers as text at which readers break.
const NUMBERS: &str =
    "0 -1 7 65536 2147483648 4294967296 1000000000000 18446744073709551616 1e39 -1e308 1e999 5e-324 0.1 nan -inf";
/// Pieces that change the structure of a text or what a terminal shows.
const PIECES: &str = "[ ] { } ( \" ' , : = null \n \u{1b}[31m \0 \u{feff} \u{202e} \\ ../x /dev/zero";
/// Most bytes of an input.
const MOST: usize = 1 << 20;

/// A sound file with one to eight changes: inside of what gzip packed, and with the sums of PNG chunks made anew.
pub fn damaged(sound: &[u8], random: &mut Random) -> Vec<u8> {
    let mut content = Vec::new();
    if sound.starts_with(b"\x1f\x8b") && GzDecoder::new(sound).read_to_end(&mut content).is_ok() {
        return packed(&damaged(&content, random));
    }
    let mut bytes = sound.to_vec();
    for _ in 0..1 + below(random, 8) * below(random, 2) {
        change(&mut bytes, random);
        bytes.truncate(MOST);
    }
    if bytes.starts_with(b"\x89PNG") && below(random, 6) > 0 {
        mend_sums(&mut bytes);
    }
    bytes
}

/// Packed by gzip.
pub fn packed(content: &[u8]) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::fast());
    writer.write_all(content).unwrap();
    writer.finish().unwrap()
}

/// Below `bound`; 0 for 0.
fn below(random: &mut Random, bound: usize) -> usize {
    random.below(bound.max(1) as u32) as usize
}

fn one_of<'a>(words: &'a str, random: &mut Random) -> &'a str {
    let words: Vec<&str> = words.split(' ').collect();
    words[below(random, words.len())]
}

fn change(bytes: &mut Vec<u8>, random: &mut Random) {
    let at = below(random, bytes.len());
    let longest = if below(random, 4) == 0 { MOST } else { 16 };
    let to = (at + below(random, longest)).min(bytes.len());
    match below(random, 9) {
        0 if at < bytes.len() => bytes[at] ^= 1 << below(random, 8),
        1 => bytes.truncate(at),
        2 => drop(bytes.drain(at..to)),
        // A piece again, elsewhere.
        3 => {
            let (piece, place) = (bytes[at..to].to_vec(), below(random, bytes.len()));
            drop(bytes.splice(place..place, piece));
        }
        // A piece many times, as of brackets.
        4 => {
            let piece = one_of(PIECES, random);
            let times = if below(random, 16) == 0 { below(random, 100_000) } else { 1 };
            drop(bytes.splice(at..at, piece.repeat(times).into_bytes()));
        }
        // Lengths and values of binary files mostly begin at a multiple of their width.
        5 => {
            let width = [2, 4, 8][below(random, 3)];
            let integer = INTEGERS[below(random, INTEGERS.len())];
            let new = if below(random, 4) == 0 { 1e300f64.to_le_bytes() } else { integer.to_le_bytes() };
            let at = at - at % width;
            let end = (at + width).min(bytes.len());
            bytes[at..end].copy_from_slice(&new[..end - at]);
        }
        _ => replace_number(bytes, at, random),
    }
}

/// Another number in the place of the next one in a text. In a binary file what follows stays where it is.
fn replace_number(bytes: &mut Vec<u8>, at: usize, random: &mut Random) {
    let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit).map(|found| at + found) else { return };
    let belongs = |byte: &u8| byte.is_ascii_digit() || b"+-.e".contains(byte);
    let length = bytes[start..].iter().position(|byte| !belongs(byte)).unwrap_or(bytes.len() - start);
    let mut new = one_of(NUMBERS, random).as_bytes().to_vec();
    if std::str::from_utf8(bytes).is_err() {
        new.resize(length, b' ');
    }
    drop(bytes.splice(start..start + length, new));
}

/// Makes the sums of a PNG file's chunks those of their data.
fn mend_sums(bytes: &mut [u8]) {
    let mut start = 8;
    while let Some(length) = bytes.get(start..start + 4) {
        let end = start + 8 + u32::from_be_bytes(length.try_into().unwrap()) as usize;
        if end + 4 > bytes.len() {
            return;
        }
        let mut sum = Crc::new();
        sum.update(&bytes[start + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.sum().to_be_bytes());
        start = end + 4;
    }
}
