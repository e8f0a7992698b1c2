//! Files of `torch.save` from PyTorch 1.6 on: a zip archive, nothing in it packed, with one pickle and a file a storage.

use std::fs::File;
use std::io::BufReader;

use zip::{CompressionMethod, ZipArchive};

use super::pickle::{Described, named, unpickle};
use super::{Contents, Parsed, Stored, text};

/// The pickle's name below the archive's one folder.
const PICKLE: &str = "/data.pkl";

type Archive<'a, 'b> = ZipArchive<&'a mut BufReader<&'b File>>;

pub(super) fn read(file: &mut BufReader<&File>) -> Parsed<Contents> {
    let mut archive = ZipArchive::new(file).map_err(text)?;
    let pickle = archive.file_names().flatten().find(|name| name.ends_with(PICKLE)).map(String::from);
    let pickle = pickle.ok_or("it has no data.pkl")?;
    place(&mut archive, &pickle)?;
    let state = unpickle(&mut BufReader::new(archive.by_name(&pickle).map_err(text)?))?;
    let folder = pickle.strip_suffix(PICKLE).unwrap_or_default();
    let named = named(state)?;
    let place = |(name, tensor)| (name, locate(&mut archive, folder, &tensor));
    let tensors = named.tensors.into_iter().map(place).collect();
    Ok(Contents { tensors, integers: named.integers, ..Contents::default() })
}

fn locate(archive: &mut Archive, folder: &str, tensor: &Described) -> Parsed<Stored> {
    let (start, size) = place(archive, &format!("{folder}/data/{}", tensor.storage.key))?;
    tensor.within(start, size)
}

/// First byte and length of a file of the archive.
fn place(archive: &mut Archive, name: &str) -> Parsed<(u64, u64)> {
    let file = archive.by_name(name).map_err(|e| format!("{name}: {e}"))?;
    if file.compression() != CompressionMethod::Stored {
        return Err(format!("{name} is packed, which torch.save never does"));
    }
    let start = file.data_start().ok_or_else(|| format!("{name} has no data"))?;
    Ok((start, file.size()))
}
