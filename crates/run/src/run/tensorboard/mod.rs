//! Writes event files for TensorBoard: records with checksums around small protocol-buffer messages, both encoded
//! here.
//!
//! A record is the payload's length (u64), a checksum of those eight bytes (u32), the payload and
//! its checksum, all little-endian; the checksum is CRC-32C, rotated and offset. The payload is an
//! `Event` message, of which [`messages`] names the fields in use.
//!
//! Event files contain wall times, so they differ between two equal runs.

mod messages;

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use messages::{
    any_value, bytes_field, event, fixed32_field, fixed64_field, hparams, image, map, metadata, plugin, session_end,
    session_log, session_start, summary, tensor, value, varint_field,
};

use super::scalars::check_finite;
use crate::base::{Error, Image, Result};
use crate::draw::pictures::encode_png8;
use crate::runtime::host::{host_name, unix_seconds};

const PREFIX: &str = "events.out.tfevents.";
/// Offset of a rotated checksum, as the record format requires. It keeps checksums useful for data that contains
/// checksums.
const MASK: u32 = 0xa282_ead8;

/// Appends events to one file in a run's `tensorboard/` folder. Every event reaches the file in
/// one write; a half-written last record is skipped by TensorBoard.
#[derive(Debug)]
pub struct EventWriter {
    path: PathBuf,
    file: File,
}

impl EventWriter {
    /// Creates an event file in `dir`. Each start or resumption of a run has its own; names sort in the order of
    /// creation, as TensorBoard expects. With `resumed_step`, the checkpoint's step, TensorBoard is told to drop the
    /// later steps of earlier files, because they are written again.
    pub fn create(dir: &Path, resumed_step: Option<u64>) -> Result<EventWriter> {
        let path = dir.join(next_name(dir).map_err(|error| Error::unwritable(dir, &error))?);
        let file = File::create_new(&path).map_err(|error| Error::unwritable(&path, &error))?;
        let mut writer = EventWriter { path, file };
        writer.write(0, &bytes_field(event::FILE_VERSION, b"brain.Event:2"))?;
        if let Some(step) = resumed_step {
            let session = varint_field(session_log::STATUS, session_log::START);
            writer.write(step.saturating_add(1), &bytes_field(event::SESSION_LOG, &session))?;
        }
        Ok(writer)
    }

    /// Appends scalars of one step, each under its tag; TensorBoard shows `a/b` in group `a`. Values are stored as
    /// f32. A number that is not finite is an [`Error::Diverged`], and nothing is written.
    pub fn scalars(&mut self, step: u64, values: &[(&str, f64)]) -> Result<()> {
        let mut summary = Vec::new();
        for &(tag, value) in values {
            check_finite(step, tag, value)?;
            let mut message = bytes_field(value::TAG, tag.as_bytes());
            message.extend(fixed32_field(value::SIMPLE_VALUE, value as f32));
            summary.extend(bytes_field(summary::VALUE, &message));
        }
        self.write(step, &bytes_field(event::SUMMARY, &summary))
    }

    /// Appends an image of one step.
    pub fn image(&mut self, step: u64, tag: &str, picture: &Image) -> Result<()> {
        let png = encode_png8(picture).map_err(|reason| self.unwritable(&reason))?;
        let mut image = varint_field(image::HEIGHT, picture.height as u64);
        image.extend(varint_field(image::WIDTH, picture.width as u64));
        image.extend(varint_field(image::COLORSPACE, picture.channels as u64));
        image.extend(bytes_field(image::ENCODED, &png));
        let mut message = bytes_field(value::TAG, tag.as_bytes());
        message.extend(bytes_field(value::IMAGE, &image));
        self.write(step, &bytes_field(event::SUMMARY, &bytes_field(summary::VALUE, &message)))
    }

    /// Writes settings for the table of the HParams tab: numbers, booleans, and other values as text. Runs of one
    /// `group` are its seeds.
    pub fn settings(&mut self, group: &str, settings: &[(String, toml::Value)]) -> Result<()> {
        let mut start = Vec::new();
        for (name, setting) in settings {
            let entry = [bytes_field(map::KEY, name.as_bytes()), bytes_field(map::VALUE, &any_value(setting))].concat();
            start.extend(bytes_field(session_start::HPARAMS, &entry));
        }
        start.extend(bytes_field(session_start::GROUP_NAME, group.as_bytes()));
        start.extend(fixed64_field(session_start::TIME, unix_seconds()));
        self.hparams("_hparams_/session_start_info", &bytes_field(hparams::SESSION_START, &start))
    }

    /// Writes for the same table that the run is finished.
    pub fn finished(&mut self) -> Result<()> {
        let end =
            [varint_field(session_end::STATUS, session_end::SUCCESS), fixed64_field(session_end::TIME, unix_seconds())];
        self.hparams("_hparams_/session_end_info", &bytes_field(hparams::SESSION_END, &end.concat()))
    }

    /// Writes data of the plugin `hparams`, together with a tensor of one 0 that the reader expects.
    fn hparams(&mut self, tag: &str, data: &[u8]) -> Result<()> {
        let plugin = [bytes_field(plugin::NAME, b"hparams"), bytes_field(plugin::CONTENT, data)].concat();
        let shape = bytes_field(tensor::DIM, &varint_field(tensor::SIZE, 1));
        let zero = [
            varint_field(tensor::DTYPE, tensor::FLOAT),
            bytes_field(tensor::SHAPE, &shape),
            bytes_field(tensor::FLOATS, &0f32.to_le_bytes()),
        ];
        let message = [
            bytes_field(value::TAG, tag.as_bytes()),
            bytes_field(value::TENSOR, &zero.concat()),
            bytes_field(value::METADATA, &bytes_field(metadata::PLUGIN, &plugin)),
        ];
        self.write(0, &bytes_field(event::SUMMARY, &bytes_field(summary::VALUE, &message.concat())))
    }

    /// Returns the path of the event file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends one event; `content` is its encoded field besides time and step.
    fn write(&mut self, step: u64, content: &[u8]) -> Result<()> {
        let mut message = fixed64_field(event::WALL_TIME, unix_seconds());
        message.extend(varint_field(event::STEP, step));
        message.extend_from_slice(content);
        self.file.write_all(&record(&message)).map_err(|error| self.unwritable(&error.to_string()))
    }

    fn unwritable(&self, reason: &str) -> Error {
        Error::Output(format!("cannot write {}: {reason}", self.path.display()))
    }
}

/// Returns `events.out.tfevents.{seconds}.{host}.{process}`, with seconds later than any file's in `dir`.
fn next_name(dir: &Path) -> std::io::Result<String> {
    let mut seconds = unix_seconds() as u64;
    for entry in fs::read_dir(dir)? {
        let name = entry?.file_name();
        let existing = name.to_str().and_then(|name| name.strip_prefix(PREFIX)?.split('.').next()?.parse().ok());
        seconds = seconds.max(existing.map_or(0, |existing: u64| existing.saturating_add(1)));
    }
    Ok(format!("{PREFIX}{seconds:010}.{}.{}", host_name(), std::process::id()))
}

fn record(payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u64).to_le_bytes();
    let mut bytes = Vec::with_capacity(payload.len() + 16);
    bytes.extend(length);
    bytes.extend(masked_checksum(&length).to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes.extend(masked_checksum(payload).to_le_bytes());
    bytes
}

fn masked_checksum(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(MASK)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CRC-32C bit by bit, independent of the crate that the writer uses.
    fn slow_checksum(bytes: &[u8]) -> u32 {
        let mut sum = !0u32;
        for &byte in bytes {
            sum ^= byte as u32;
            for _ in 0..8 {
                sum = if sum & 1 == 1 { sum >> 1 ^ 0x82f6_3b78 } else { sum >> 1 };
            }
        }
        let sum = !sum;
        sum.rotate_right(15).wrapping_add(0xa282_ead8)
    }

    fn number(bytes: &[u8]) -> u64 {
        bytes.iter().rev().fold(0, |number, &byte| number << 8 | byte as u64)
    }

    fn read_records(mut bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut records = Vec::new();
        while !bytes.is_empty() {
            let length = number(&bytes[..8]) as usize;
            assert_eq!(number(&bytes[8..12]) as u32, slow_checksum(&bytes[..8]));
            let payload = &bytes[12..12 + length];
            assert_eq!(number(&bytes[12 + length..16 + length]) as u32, slow_checksum(payload));
            records.push(payload.to_vec());
            bytes = &bytes[16 + length..];
        }
        records
    }

    fn read_varint(bytes: &mut &[u8]) -> u64 {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = bytes[0];
            *bytes = &bytes[1..];
            number |= ((byte & 0x7f) as u64) << shift;
            if byte < 0x80 {
                break;
            }
        }
        number
    }

    /// Returns the fields of a message: number and raw content (a varint as its eight bytes).
    fn read_fields(mut bytes: &[u8]) -> Vec<(u64, Vec<u8>)> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let key = read_varint(&mut bytes);
            let length = match key & 7 {
                0 => {
                    fields.push((key >> 3, read_varint(&mut bytes).to_le_bytes().to_vec()));
                    continue;
                }
                1 => 8,
                2 => read_varint(&mut bytes) as usize,
                5 => 4,
                kind => panic!("wire type {kind}"),
            };
            fields.push((key >> 3, bytes[..length].to_vec()));
            bytes = &bytes[length..];
        }
        fields
    }

    fn field(message: &[u8], wanted: u64) -> Vec<u8> {
        read_fields(message).into_iter().find(|(field, _)| *field == wanted).expect("field").1
    }

    #[test]
    fn events_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path(), None).unwrap();
        writer.scalars(300, &[("loss/clean", 0.125), ("psnr", 21.5)]).unwrap();
        let picture = Image { width: 2, height: 1, channels: 3, pixels: vec![0.0, 0.5, 1.0, 1.0, 0.5, 0.0] };
        writer.image(301, "view", &picture).unwrap();

        let records = read_records(&fs::read(writer.path()).unwrap());
        assert_eq!(records.len(), 3);
        assert_eq!(field(&records[0], 3), b"brain.Event:2");
        let time = f64::from_le_bytes(field(&records[1], 1).try_into().unwrap());
        assert!((unix_seconds() - time).abs() < 60.0);
        assert_eq!(number(&field(&records[1], 2)), 300);
        let values = read_fields(&field(&records[1], 5));
        let read: Vec<(Vec<u8>, f32)> = values
            .iter()
            .map(|(_, value)| (field(value, 1), f32::from_le_bytes(field(value, 2).try_into().unwrap())))
            .collect();
        assert_eq!(read, [(b"loss/clean".to_vec(), 0.125), (b"psnr".to_vec(), 21.5)]);
        let png = field(&field(&field(&field(&records[2], 5), 1), 4), 4);
        assert_eq!(::image::load_from_memory(&png).unwrap().width(), 2);
    }

    #[test]
    fn settings_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path(), None).unwrap();
        let settings = [("method".to_string(), "aug-nerf".into()), ("train.steps".to_string(), 250.into())];
        writer.settings("a1b2", &settings).unwrap();
        writer.finished().unwrap();
        let records = read_records(&fs::read(writer.path()).unwrap());
        let of = |record: &[u8]| {
            let value = field(&field(record, 5), 1);
            let plugin = field(&field(&value, 9), 1);
            assert_eq!(field(&plugin, 1), b"hparams");
            (String::from_utf8(field(&value, 1)).unwrap(), field(&plugin, 2))
        };
        let (tag, data) = of(&records[1]);
        assert_eq!(tag, "_hparams_/session_start_info");
        let start = field(&data, 3);
        assert_eq!(field(&start, 4), b"a1b2");
        let entries: Vec<Vec<u8>> =
            read_fields(&start).into_iter().filter(|(number, _)| *number == 1).map(|(_, entry)| entry).collect();
        assert_eq!(
            (field(&entries[0], 1), field(&field(&entries[0], 2), 3)),
            (b"method".to_vec(), b"aug-nerf".to_vec())
        );
        let steps = f64::from_le_bytes(field(&field(&entries[1], 2), 2).try_into().unwrap());
        assert_eq!((field(&entries[1], 1), steps), (b"train.steps".to_vec(), 250.0));
        let (tag, data) = of(&records[2]);
        assert_eq!((tag.as_str(), number(&field(&field(&data, 4), 1))), ("_hparams_/session_end_info", 1));
    }

    #[test]
    fn a_resumption_gets_a_later_file_that_names_its_step() {
        let dir = tempfile::tempdir().unwrap();
        let first = EventWriter::create(dir.path(), None).unwrap();
        let second = EventWriter::create(dir.path(), Some(10)).unwrap();
        assert!(second.path() > first.path());
        let records = read_records(&fs::read(second.path()).unwrap());
        assert_eq!(number(&field(&records[1], 2)), 11);
        assert_eq!(number(&field(&field(&records[1], 7), 1)), 1);
    }

    #[test]
    fn a_number_that_is_not_finite_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path(), None).unwrap();
        let before = fs::read(writer.path()).unwrap();
        assert_eq!(writer.scalars(1, &[("loss", f64::INFINITY)]).unwrap_err().exit_code(), 6);
        assert_eq!(fs::read(writer.path()).unwrap(), before);
        assert_eq!(EventWriter::create(&dir.path().join("missing"), None).unwrap_err().exit_code(), 4);
    }

    #[test]
    fn checksums_of_the_standards_example() {
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(masked_checksum(b"123456789"), slow_checksum(b"123456789"));
    }
}
