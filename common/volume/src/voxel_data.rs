//! Reads the voxels described by a text header (NRRD or MetaImage). The voxels are attached to the
//! header or stored in separate data files, in one of six encodings.

mod stream;

use crate::error::bad;
use crate::error::{Error, Result};
use crate::voxels::{Endian, ScalarType, Voxels};
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;
pub(crate) use stream::Stream;

/// Maximum size in bytes of a text header. This is enough for a list of 100,000 data files with
/// names of 167 bytes. Longer headers are rejected, so that a damaged file cannot exhaust the
/// memory.
pub(crate) const MOST_HEADER_BYTES: u64 = 16 << 20;

/// Encoding of the voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    Raw,
    Text,
    Hex,
    Gzip,
    Bzip2,
    Zlib,
}

/// Location of the voxels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum DataFiles {
    /// After the header, in the same file.
    Attached,
    /// In these files, in order. File names are relative to the folder of the header.
    Named(Vec<String>),
}

/// Opens a file for reading. A gzip-compressed file is decompressed as it is read.
pub(crate) fn open(path: &Path) -> io::Result<Stream<BufReader<File>>> {
    let mut file = BufReader::with_capacity(1 << 17, File::open(path)?);
    let is_compressed = file.fill_buf()?.starts_with(&[0x1f, 0x8b]);
    Ok(Stream::new(file, if is_compressed { Coding::Gzip } else { Coding::Raw }))
}

/// Reads a header line and removes its line ending. Returns `None` at the end of the file.
pub(crate) fn read_line(path: &Path, reader: &mut impl BufRead) -> Result<Option<String>> {
    let mut line = Vec::new();
    reader
        .read_until(b'\n', &mut line)
        .map_err(|error| Error::file(path, "read", error, "check the disk that holds the file"))?;
    if line.is_empty() {
        return Ok(None);
    }
    while line.last().is_some_and(|&byte| byte == b'\n' || byte == b'\r') {
        line.pop();
    }
    Ok(Some(String::from_utf8_lossy(&line).into_owned()))
}

/// The layout of the voxel data according to a header.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) scalar: ScalarType,
    pub(crate) coding: Coding,
    pub(crate) endian: Option<Endian>,
    pub(crate) line_skip: u64,
    /// Number of decoded bytes before the first voxel. A negative value -n means that n - 1 bytes
    /// follow the last voxel.
    pub(crate) byte_skip: i64,
    pub(crate) files: DataFiles,
}

/// Reads `count` voxels. The reader `attached` must be positioned right after the header. Adds a
/// remark if any bytes follow the compressed data.
pub(crate) fn read_voxels(
    path: &Path,
    layout: &Layout,
    count: usize,
    attached: BufReader<File>,
    remarks: &mut Vec<String>,
) -> Result<Voxels> {
    if layout.endian.is_none() && layout.scalar.bytes() > 1 && layout.coding != Coding::Text {
        return Err(bad(
            path,
            format!("does not define the byte order of its {} voxels", layout.scalar.name()),
            "with the wrong byte order, the values would be wrong",
            "add the byte order to the header ('endian: little' or big in NRRD)",
        ));
    }
    if layout.byte_skip < 0 && layout.coding == Coding::Text {
        return Err(bad(
            path,
            format!("skips {} bytes of text", layout.byte_skip),
            "bytes cannot be counted from the end of text",
            "correct the header",
        ));
    }
    match &layout.files {
        DataFiles::Attached => read_part(path, layout, count, attached, remarks),
        DataFiles::Named(names) => {
            let folder = path.parent().unwrap_or(Path::new(""));
            if names.is_empty() || !count.is_multiple_of(names.len()) {
                return Err(bad(
                    path,
                    format!("names {} data files for {count} voxels", names.len()),
                    "every file must contain the same number of voxels",
                    "correct the data files in the header",
                ));
            }
            let mut whole: Option<Voxels> = None;
            for name in names {
                let part_path = folder.join(name);
                let file = File::open(&part_path).map_err(|error| {
                    Error::file(
                        &part_path,
                        "read",
                        error,
                        format!("copy this file there; the header {} names it", path.display()),
                    )
                })?;
                let part = read_part(&part_path, layout, count / names.len(), BufReader::new(file), remarks)?;
                match &mut whole {
                    None => whole = Some(part),
                    Some(whole) => whole.append(part),
                }
            }
            whole.ok_or_else(|| bad(path, "names no data file", "there are no voxels", "correct the header"))
        }
    }
}

/// Reads the voxels of one file, starting at the current position of the reader.
fn read_part(
    path: &Path,
    layout: &Layout,
    count: usize,
    mut reader: BufReader<File>,
    remarks: &mut Vec<String>,
) -> Result<Voxels> {
    let (voxels, goes_on) =
        read_values(&mut reader, layout, count).map_err(|error| data_error(path, layout, count, error))?;
    if goes_on {
        remarks.push(goes_on_remark(path));
    }
    Ok(voxels)
}

/// Returns the remark for a file that contains data after the last voxel.
pub(crate) fn goes_on_remark(path: &Path) -> String {
    format!("{} has data after the last voxel, which is ignored", path.display())
}

/// Reads the voxels. Also returns whether any bytes follow the compressed data. Fails if decoded
/// data remains after the last voxel, unless the byte skip is negative.
fn read_values(reader: &mut BufReader<File>, layout: &Layout, count: usize) -> io::Result<(Voxels, bool)> {
    skip_lines(reader, layout.line_skip)?;
    if layout.coding == Coding::Text {
        skip_bytes(reader, layout.byte_skip.unsigned_abs())?;
        return Ok((read_text(reader, layout.scalar, count)?, false));
    }
    let start = reader.stream_position()?;
    let mut skip = layout.byte_skip.unsigned_abs();
    if layout.byte_skip < 0 {
        // the length is known only after decoding all data
        let length = io::copy(&mut Stream::new(&mut *reader, layout.coding), &mut io::sink())?;
        let needed = (count as u64).saturating_mul(layout.scalar.bytes() as u64).saturating_add(skip - 1);
        skip = length.checked_sub(needed).ok_or_else(|| {
            io::Error::new(ErrorKind::UnexpectedEof, format!("{length} bytes, but {needed} are needed"))
        })?;
        reader.seek(SeekFrom::Start(start))?;
    }
    let mut stream = Stream::new(&mut *reader, layout.coding);
    skip_bytes(&mut stream, skip)?;
    let voxels = Voxels::read_from(&mut stream, layout.scalar, layout.endian.unwrap_or(Endian::Little), count)?;
    if layout.byte_skip < 0 {
        io::copy(&mut stream, &mut io::sink())?;
    } else if stream.has_more()? {
        return Err(trailing("more data"));
    }
    Ok((voxels, stream.leaves_bytes()?))
}

/// Converts an I/O error in the voxel data to an error message for the user.
fn data_error(path: &Path, layout: &Layout, count: usize, error: io::Error) -> Error {
    let promised = format!("the header declares {count} voxels of type {} in this file", layout.scalar.name());
    match error.kind() {
        ErrorKind::UnexpectedEof => bad(
            path,
            format!("the data is truncated ({error})"),
            promised,
            "copy or download the file again, or correct the sizes in the header",
        ),
        ErrorKind::InvalidData | ErrorKind::InvalidInput => {
            bad(path, format!("the data does not match the header: {error}"), promised, "write the file again")
        }
        _ => Error::file(path, "read the voxels", error, "copy or download the file again"),
    }
}

fn trailing(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, format!("{what} after the last voxel"))
}

fn skip_lines(reader: &mut impl BufRead, lines: u64) -> io::Result<()> {
    for _ in 0..lines {
        if reader.skip_until(b'\n')? == 0 {
            return Err(io::Error::new(ErrorKind::UnexpectedEof, "it ends within the lines to skip"));
        }
    }
    Ok(())
}

fn skip_bytes(reader: &mut impl Read, bytes: u64) -> io::Result<()> {
    if io::copy(&mut Read::take(reader, bytes), &mut io::sink())? == bytes {
        return Ok(());
    }
    Err(io::Error::new(ErrorKind::UnexpectedEof, "it ends within the bytes to skip"))
}

/// Parses numbers that are separated by white space or commas.
fn read_text(reader: &mut impl BufRead, scalar: ScalarType, count: usize) -> io::Result<Voxels> {
    let mut voxels = Voxels::empty(scalar);
    let mut line = Vec::new();
    loop {
        line.clear();
        // A long line is read in parts. Each part extends to a separator, because a number must not
        // be split.
        Read::take(&mut *reader, 1 << 16).read_until(b'\n', &mut line)?;
        if line.len() == 1 << 16 {
            while let Some(&byte) = reader.fill_buf()?.first() {
                if is_separator(byte) || line.len() > 1 << 17 {
                    break;
                }
                line.push(byte);
                reader.consume(1);
            }
        }
        if line.is_empty() {
            break;
        }
        for word in line.split(|&byte| is_separator(byte)).filter(|word| !word.is_empty()) {
            let text = std::str::from_utf8(word).ok();
            if voxels.len() == count {
                return Err(trailing("more numbers"));
            }
            if text.is_none_or(|text| !voxels.push_text(text)) {
                let shown: String = String::from_utf8_lossy(word).chars().take(40).collect();
                let text = format!("'{shown}' is not a number of type {}", scalar.name());
                return Err(io::Error::new(ErrorKind::InvalidData, text));
            }
        }
    }
    if voxels.len() < count {
        let text = format!("{} numbers, but {count} are needed", voxels.len());
        return Err(io::Error::new(ErrorKind::UnexpectedEof, text));
    }
    Ok(voxels)
}

fn is_separator(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == b','
}

/// Expands a `printf` pattern with one integer into file names, for the numbers from `low` to
/// `high` in steps of `step`. Returns `None` if the pattern or the range is invalid.
pub(crate) fn numbered_names(format: &str, low: i64, high: i64, step: i64) -> Option<Vec<String>> {
    let (prefix, rest) = format.split_once('%')?;
    let end = rest.find(|c: char| !c.is_ascii_digit())?;
    let (width, suffix) = rest.split_at(end);
    let suffix = suffix.strip_prefix(['d', 'i', 'u']).filter(|suffix| !suffix.contains('%'))?;
    let zero = width.starts_with('0');
    let width: usize = if width.is_empty() { 0 } else { width.parse().ok()? };
    let count = high.checked_sub(low)?.checked_div(step)?;
    if !(0..1_000_000).contains(&count) || width > 100 {
        return None;
    }
    let name = |index: i64| {
        let value = low + index * step;
        let digits = if zero { format!("{value:0width$}") } else { format!("{value:width$}") };
        format!("{prefix}{digits}{suffix}")
    };
    Some((0..=count).map(name).collect())
}

#[cfg(test)]
mod tests;
