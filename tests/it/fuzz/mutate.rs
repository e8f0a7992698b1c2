//! Damage to files: of bytes, of text with numbers and names, of what a format protects by sums and lengths.

use super::formats::{self, Format};

/// A generator of numbers that needs nothing of the program (splitmix64, Steele et al. 2014).
pub struct Dice(u64);

impl Dice {
    /// The dice of one input of a reader.
    pub fn new(seed: u64, reader: &str, input: u64) -> Dice {
        let name = reader
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3));
        let mut dice = Dice(seed ^ name.rotate_left(17) ^ input.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        dice.next();
        dice
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Below `n`; 0 for 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    pub fn pick<'a, T: ?Sized>(&mut self, from: &[&'a T]) -> &'a T {
        from[self.below(from.len())]
    }

    /// A range of a text of `length`, mostly short.
    fn range(&mut self, length: usize) -> std::ops::Range<usize> {
        let start = self.below(length + 1);
        let longest = if self.one_in(4) { length } else { 16 };
        start..(start + self.below(longest + 1)).min(length)
    }
}

/// Integers at which lengths and counts break.
const INTEGERS: [u64; 14] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x1_0000_0000,
    1_000_000_000_000,
    i64::MAX as u64,
    1 << 63,
    u64::MAX,
];
/// Numbers as text at which readers break.
const NUMBERS: [&str; 26] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "7",
    "255",
    "65536",
    "2147483648",
    "4294967296",
    "1000000000000",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "99999999999999999999999",
    "1e39",
    "-1e39",
    "1e308",
    "1e999",
    "5e-324",
    "1e-45",
    "0.1",
    "nan",
    "inf",
    "-inf",
    "1e12",
];
/// Pieces that change the structure of a text.
const PIECES: [&str; 30] = [
    "[",
    "]",
    "{",
    "}",
    "(",
    ")",
    "\"",
    "'",
    "\"\"\"",
    ",",
    ".",
    ":",
    "=",
    "#",
    "\n",
    "\r\n",
    " ",
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "\u{1b}[31m",
    "\0",
    "\u{feff}",
    "\u{202e}",
    "\\u0000",
    "\\",
    "../../x",
    "/dev/zero",
];
/// Most bytes of an input.
const MOST: usize = 1 << 20;

/// An input made of `seeds[first]` by one to eight changes.
pub fn mutated(format: Format, seeds: &[Vec<u8>], dice: &mut Dice) -> Vec<u8> {
    let first = dice.below(seeds.len());
    let mut bytes = seeds[first].clone();
    let changes = 1 + if dice.one_in(2) { 0 } else { dice.below(8) };
    for _ in 0..changes {
        formats::change(format, &mut bytes, seeds, dice);
        bytes.truncate(MOST);
    }
    bytes
}

/// One change of bytes that mean anything.
pub fn change_bytes(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    if bytes.is_empty() {
        bytes.push(dice.next() as u8);
        return;
    }
    let at = dice.below(bytes.len());
    match dice.below(11) {
        0 | 1 => bytes[at] ^= 1 << dice.below(8),
        2 => bytes[at] = dice.next() as u8,
        3 => bytes[at] = INTEGERS[dice.below(5)] as u8,
        4 => overwrite(bytes, at, dice),
        5 => drop(bytes.drain(dice.range(bytes.len()))),
        6 => {
            let new: Vec<u8> = (0..dice.below(16)).map(|_| dice.next() as u8).collect();
            drop(bytes.splice(at..at, new));
        }
        7 => {
            let piece = bytes[dice.range(bytes.len())].to_vec();
            let times = if dice.one_in(8) { dice.below(1000) } else { 1 + dice.below(4) };
            let times = times.min(MOST / piece.len().max(1));
            drop(bytes.splice(at..at, piece.repeat(times)));
        }
        8 => {
            let other = &seeds[dice.below(seeds.len())];
            let piece = other[dice.range(other.len())].to_vec();
            let end = (at + dice.below(piece.len() + 1)).min(bytes.len());
            drop(bytes.splice(at..end, piece));
        }
        9 => bytes.truncate(at),
        _ => {
            let piece = bytes[dice.range(bytes.len())].to_vec();
            let end = (at + piece.len()).min(bytes.len());
            bytes[at..end].copy_from_slice(&piece[..end - at]);
        }
    }
}

/// A number of 1 to 8 bytes in either order, whole or a fraction.
fn overwrite(bytes: &mut [u8], at: usize, dice: &mut Dice) {
    let value = INTEGERS[dice.below(INTEGERS.len())];
    let fraction: f64 = NUMBERS[dice.below(NUMBERS.len())].parse().unwrap_or(0.5);
    let mut new = match dice.below(6) {
        0 => (value as u16).to_le_bytes().to_vec(),
        1 => (value as u32).to_le_bytes().to_vec(),
        2 => (value as u32).to_be_bytes().to_vec(),
        3 => value.to_le_bytes().to_vec(),
        4 => (fraction as f32).to_le_bytes().to_vec(),
        _ => fraction.to_le_bytes().to_vec(),
    };
    // Fields mostly begin at a multiple of their length.
    let at = if dice.one_in(2) { at - at % new.len() } else { at };
    new.truncate(bytes.len() - at);
    bytes[at..at + new.len()].copy_from_slice(&new);
}

/// One change of a text that has numbers, words and lines.
pub fn change_text(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    match dice.below(10) {
        0..=2 => replace_word(bytes, is_number, dice, |_, dice| dice.pick(&NUMBERS).as_bytes().to_vec()),
        3 => replace_word(bytes, is_name, dice, |words, dice| words[dice.below(words.len())].to_vec()),
        4 => replace_word(bytes, is_name, dice, |_, dice| dice.pick(&PIECES).as_bytes().to_vec()),
        5 => {
            let at = dice.below(bytes.len() + 1);
            let times = if dice.one_in(16) { 1 + dice.below(100_000) } else { 1 + dice.below(2) };
            drop(bytes.splice(at..at, dice.pick(&PIECES).repeat(times).into_bytes()));
        }
        6 | 7 => change_lines(bytes, seeds, dice),
        8 => {
            let at = dice.below(bytes.len() + 1);
            let times = if dice.one_in(16) { dice.below(200_000) } else { dice.below(40) };
            drop(bytes.splice(at..at, dice.pick(&["x", "9", ".a", " ", "\u{3b1}"]).repeat(times).into_bytes()));
        }
        _ => change_bytes(bytes, seeds, dice),
    }
}

fn is_number(byte: u8) -> bool {
    byte.is_ascii_digit() || matches!(byte, b'-' | b'+' | b'.' | b'e')
}

fn is_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'.')
}

/// Puts another word in the place of one of those that `belongs` makes up.
fn replace_word(
    bytes: &mut Vec<u8>,
    belongs: fn(u8) -> bool,
    dice: &mut Dice,
    new: fn(&[&[u8]], &mut Dice) -> Vec<u8>,
) {
    let words: Vec<&[u8]> = bytes.split(|byte| !belongs(*byte)).filter(|word| !word.is_empty()).collect();
    if words.is_empty() {
        return;
    }
    let word = words[dice.below(words.len())];
    let start = word.as_ptr() as usize - bytes.as_ptr() as usize;
    let (end, new) = (start + word.len(), new(&words, dice));
    drop(bytes.splice(start..end, new));
}

/// Leaves a line out, repeats it, moves it, or takes one of another file.
fn change_lines(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    let mut lines: Vec<Vec<u8>> = bytes.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
    if lines.is_empty() {
        return;
    }
    let (at, to) = (dice.below(lines.len()), dice.below(lines.len()));
    match dice.below(4) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(to, lines[at].clone()),
        2 => lines.swap(at, to),
        _ => {
            let other = &seeds[dice.below(seeds.len())];
            let others: Vec<&[u8]> = other.split_inclusive(|byte| *byte == b'\n').collect();
            lines.insert(at, others.get(dice.below(others.len())).unwrap_or(&&b""[..]).to_vec());
        }
    }
    *bytes = lines.concat();
}
