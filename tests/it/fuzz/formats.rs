//! Formats that protect their content by lengths and sums: changes get below them, so that readers are not stopped by the
//! first sum that is wrong.

use std::io::{Read, Write};

use flate2::{Compression, read::GzDecoder, write::GzEncoder};

use super::mutate::{Dice, change_bytes, change_text};

/// What kind of file an input is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Lines, names, numbers.
    Text,
    /// Bytes.
    Bytes,
    /// A text up to a line `end_header`, bytes after it.
    Ply,
    /// Chunks with sums.
    Png,
    /// A header of a stated length, a text, and bytes after it.
    Npy,
    /// The same.
    Safetensors,
    /// Operations of a pickle, which stand at the file's start and in a row.
    Pickle,
    /// A zip archive with a pickle in it.
    Archive,
    /// Packed by gzip: a text or bytes.
    Gzip,
}

/// One change of a file.
pub fn change(format: Format, bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    match format {
        Format::Text => change_text(bytes, seeds, dice),
        Format::Bytes => change_bytes(bytes, seeds, dice),
        Format::Ply => {
            let end = find(bytes, b"end_header\n").map_or(0, |at| at + 11);
            let (head, tail) = bytes.split_at(end);
            *bytes = in_two(head, tail, seeds, dice).concat();
        }
        _ if dice.one_in(6) => change_bytes(bytes, seeds, dice),
        Format::Png => change_chunk(bytes, seeds, dice),
        Format::Npy => change_headed(bytes, 8, 2, seeds, dice),
        Format::Safetensors => change_headed(bytes, 0, 8, seeds, dice),
        Format::Pickle => change_pickle(bytes, seeds, dice),
        Format::Archive => change_archive(bytes, seeds, dice),
        Format::Gzip => change_packed(bytes, seeds, dice),
    }
}

/// What gzip packed; as much of it as is whole.
fn unpacked(bytes: &[u8]) -> Vec<u8> {
    let mut content = Vec::new();
    let _ = GzDecoder::new(bytes).take(1 << 24).read_to_end(&mut content);
    content
}

/// Packed by gzip.
pub fn packed(content: &[u8]) -> Vec<u8> {
    let mut writer = GzEncoder::new(Vec::new(), Compression::fast());
    writer.write_all(content).unwrap();
    writer.finish().unwrap()
}

/// Changes what is packed, or, rarely, packs much more of it.
fn change_packed(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    let mut content = unpacked(bytes);
    if dice.one_in(2000) {
        content = content.repeat((8 << 20) / content.len().max(1));
    } else {
        let contents: Vec<Vec<u8>> = seeds.iter().map(|seed| unpacked(seed)).collect();
        match content.iter().all(u8::is_ascii) {
            true => change_text(&mut content, &contents, dice),
            false => change_bytes(&mut content, &contents, dice),
        }
    }
    *bytes = packed(&content);
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

/// Changes a text before or the bytes behind it.
fn in_two(head: &[u8], tail: &[u8], seeds: &[Vec<u8>], dice: &mut Dice) -> [Vec<u8>; 2] {
    let (mut head, mut tail) = (head.to_vec(), tail.to_vec());
    match dice.below(3) {
        0 => change_bytes(&mut tail, seeds, dice),
        1 if !tail.is_empty() && tail.iter().all(|byte| byte.is_ascii()) => change_text(&mut tail, seeds, dice),
        _ => change_text(&mut head, seeds, dice),
    }
    [head, tail]
}

/// A text whose length stands at `at`, in `width` bytes, right before it.
fn change_headed(bytes: &mut Vec<u8>, at: usize, width: usize, seeds: &[Vec<u8>], dice: &mut Dice) {
    let start = at + width;
    let Some(length) = bytes.get(at..start) else { return change_bytes(bytes, seeds, dice) };
    let length = length.iter().rev().fold(0usize, |value, byte| value << 8 | usize::from(*byte));
    let end = start.saturating_add(length).min(bytes.len());
    let [head, tail] = in_two(&bytes[start..end], &bytes[end..], seeds, dice);
    let length = (head.len() as u64).to_le_bytes();
    *bytes = [&bytes[..at], &length[..width], &head, &tail].concat();
}

/// The chunks of a PNG file: kind and data.
fn chunks(bytes: &[u8]) -> Vec<([u8; 4], Vec<u8>)> {
    let mut chunks = Vec::new();
    let mut rest = bytes.get(8..).unwrap_or_default();
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let length = u32::from_be_bytes(*length) as usize;
        let (Some((kind, data)), true) = (behind.split_first_chunk::<4>(), behind.len() >= length.saturating_add(8))
        else {
            break;
        };
        chunks.push((*kind, data[..length].to_vec()));
        rest = &behind[length + 8..];
    }
    chunks
}

fn change_chunk(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    let mut chunks = chunks(bytes);
    if chunks.is_empty() {
        return change_bytes(bytes, seeds, dice);
    }
    let (at, to) = (dice.below(chunks.len()), dice.below(chunks.len()));
    match dice.below(12) {
        0 => drop(chunks.remove(at)),
        1 => chunks.insert(to, chunks[at].clone()),
        2 => chunks.swap(at, to),
        3 => {
            let kind = dice.pick(&[b"PLTE", b"tRNS", b"acTL", b"fcTL", b"fdAT", b"zTXt", b"iCCP", b"eXIf", b"gAMA"]);
            let data = (0..dice.below(64)).map(|_| dice.next() as u8).collect();
            chunks.insert(to, (*kind, data));
        }
        _ => change_bytes(&mut chunks[at].1, seeds, dice),
    }
    bytes.truncate(8);
    for (kind, data) in chunks {
        let body = [&kind[..], &data].concat();
        bytes.extend((data.len() as u32).to_be_bytes());
        bytes.extend(&body);
        bytes.extend(crc32(&body).to_be_bytes());
    }
}

/// The sum of PNG chunks and of files in a zip archive (ISO 3309).
pub fn crc32(bytes: &[u8]) -> u32 {
    /// What eight steps make of each byte.
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut entry = 0;
        while entry < 256 {
            let (mut sum, mut bit) = (entry as u32, 0);
            while bit < 8 {
                sum = if sum & 1 == 1 { 0xedb8_8320 ^ (sum >> 1) } else { sum >> 1 };
                bit += 1;
            }
            table[entry] = sum;
            entry += 1;
        }
        table
    };
    !bytes.iter().fold(!0, |sum, byte| TABLE[usize::from(sum as u8 ^ byte)] ^ (sum >> 8))
}

/// Puts in an operation of pickles, repeats some, or changes bytes.
fn change_pickle(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    // Mostly where descriptions are, not among a tensor's values.
    let at = dice.below(bytes.len().min(600) + 1);
    let small = dice.below(12) as u8;
    let operation = match dice.below(12) {
        0..=3 => vec![
            *dice
                .pick(&[
                    b"(", b")", b"]", b"}", b"t", b"a", b"e", b"s", b"u", b"R", b"Q", b"b", b"N", b"\x85", b"\x86",
                    b"\x87", b"\x88", b".", b"d", b"\x81",
                ])
                .first()
                .unwrap(),
        ],
        4 => vec![b'q', small],
        5 => vec![b'h', small],
        6 => vec![b'K', dice.next() as u8],
        7 => [&b"J"[..], &(dice.next() as u32).to_le_bytes()].concat(),
        8 => [&b"\x8a\x08"[..], &dice.next().to_le_bytes()].concat(),
        9 => {
            let length = [0, 1, 7, 65536, u32::MAX][dice.below(5)];
            [&b"X"[..], &length.to_le_bytes(), b"storage"].concat()
        }
        10 => {
            let names = ["ctorch._utils\n_rebuild_tensor_v2\n", "ccollections\nOrderedDict\n", "ctorch\nHalfStorage\n"];
            dice.pick(&names).as_bytes().to_vec()
        }
        _ => return change_bytes(bytes, seeds, dice),
    };
    let times = if dice.one_in(20) { dice.below(200_000 / operation.len()) } else { 1 + dice.below(3) };
    drop(bytes.splice(at..at, operation.repeat(times)));
}

/// Name and content of the files of an archive made by [`archive`].
fn members(bytes: &[u8]) -> Vec<(Vec<u8>, Vec<u8>)> {
    let number = |at: usize, width: usize| {
        let field = bytes.get(at..at + width)?;
        Some(field.iter().rev().fold(0usize, |value, byte| value << 8 | usize::from(*byte)))
    };
    let mut members = Vec::new();
    let mut at = 0;
    while bytes.get(at..at + 4) == Some(b"PK\x03\x04") {
        let (Some(size), Some(name)) = (number(at + 18, 4), number(at + 26, 2)) else { break };
        let start = at + 30 + name;
        let Some(content) = bytes.get(start..start.saturating_add(size)) else { break };
        members.push((bytes[at + 30..start].to_vec(), content.to_vec()));
        at = start + size;
    }
    members
}

fn change_archive(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], dice: &mut Dice) {
    let mut members = members(bytes);
    if members.is_empty() {
        return change_bytes(bytes, seeds, dice);
    }
    let at = dice.below(members.len());
    match dice.below(12) {
        0 => drop(members.remove(at)),
        1 => members.push(members[at].clone()),
        2 => change_text(&mut members[at].0, seeds, dice),
        3 => change_bytes(&mut members[at].1, seeds, dice),
        _ => {
            let pickle = members.iter().position(|(name, _)| name.ends_with(b"data.pkl")).unwrap_or(0);
            change_pickle(&mut members[pickle].1, seeds, dice);
        }
    }
    let named: Vec<(&[u8], &[u8])> = members.iter().map(|(name, content)| (&name[..], &content[..])).collect();
    *bytes = archive(&named);
}

/// A zip archive in which nothing is packed.
pub fn archive(members: &[(&[u8], &[u8])]) -> Vec<u8> {
    let (mut files, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in members {
        let mut about = vec![20, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        about.extend(crc32(content).to_le_bytes());
        about.extend((content.len() as u32).to_le_bytes().repeat(2));
        about.extend((name.len() as u16).to_le_bytes());
        about.extend([0, 0]);
        directory
            .extend([&b"PK\x01\x02\x14\0"[..], &about, &[0; 10], &(files.len() as u32).to_le_bytes(), name].concat());
        files.extend([&b"PK\x03\x04"[..], &about, name, content].concat());
    }
    let count = (members.len() as u16).to_le_bytes();
    let end = [b"PK\x05\x06\0\0\0\0", &count[..], &count, &(directory.len() as u32).to_le_bytes()].concat();
    let start = (files.len() as u32).to_le_bytes();
    [files, directory, end, start.to_vec(), vec![0, 0]].concat()
}

/// A table of float64 as NumPy stores it.
pub fn npy(shape: (usize, usize), values: &[f64]) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, {}), }}\n", shape.0, shape.1);
    let length = (header.len() as u16).to_le_bytes();
    let values: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &values].concat()
}
