//! Parses the directories of a TIFF file: one per page, each a list of tags. BigTIFF differs in
//! the sizes of numbers. The tags are those of TIFF 6.0.

use super::page::{Page, Tags};
use crate::error::{Error, Result, bad};
use crate::voxels::Endian;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum number of tags in a directory: there are 2^16 different tags.
const MOST_TAGS: u64 = 1 << 16;

/// The pages of a file.
pub(super) struct Directory {
    pub(super) pages: Vec<Page>,
    /// Text of the first page (`ImageDescription`), or an empty string.
    pub(super) description: String,
    /// Pixels per unit along x and y in the first page, and the code of the unit.
    pub(super) resolution: Option<([f64; 2], u64)>,
    /// Number of bytes in the file.
    pub(super) length: u64,
}

/// Returns the byte order of a file that starts with these bytes, and whether it is a BigTIFF.
pub(crate) fn byte_order(start: &[u8]) -> Option<(Endian, bool)> {
    Some(match start.get(..4)? {
        b"II*\0" => (Endian::Little, false),
        b"MM\0*" => (Endian::Big, false),
        b"II+\0" => (Endian::Little, true),
        b"MM\0+" => (Endian::Big, true),
        _ => return None,
    })
}

/// An open file.
struct Source<'a> {
    path: &'a Path,
    file: BufReader<File>,
    length: u64,
    endian: Endian,
    is_big: bool,
}

/// A tag of a directory.
struct Entry {
    tag: u16,
    kind: u16,
    count: u64,
    /// The values or, if they do not fit here, their position in the file.
    value: Vec<u8>,
}

impl Directory {
    /// Reads the directories of all pages. Pages of reduced size, such as thumbnails, are skipped.
    ///
    /// # Errors
    /// If the file is damaged, or if a page does not have one number per pixel.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let mut source = Source::open(path)?;
        let mut directory =
            Self { pages: Vec::new(), description: String::new(), resolution: None, length: source.length };
        let mut visited = BTreeSet::new();
        // bytes of all pages, limited below: pages that share bytes could exhaust the memory
        let mut stored = 0_u64;
        let mut next = source.first()?;
        while next != 0 {
            if !visited.insert(next) {
                return Err(source.damaged("its pages form a circle"));
            }
            let (entries, after) = source.entries(next)?;
            next = after;
            let tags = source.tags(&entries)?;
            if tags.is_reduced {
                continue;
            }
            if directory.pages.is_empty() {
                directory.description = source.text(&entries, 270)?;
                directory.resolution = source.resolution(&entries)?;
            }
            let page = source.page(&entries, &tags, directory.pages.len() + 1)?;
            stored = page.chunks.iter().fold(stored, |sum, chunk| sum.saturating_add(chunk.bytes));
            if stored > source.length {
                return Err(source.damaged("its pages have more bytes than the file"));
            }
            directory.pages.push(page);
        }
        Ok(directory)
    }
}

impl<'a> Source<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let unreadable = |error| Error::file(path, "read", error, "check the name of the volume");
        let file = File::open(path).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        // a small buffer, because directories are small and far apart
        let mut file = BufReader::with_capacity(1 << 10, file);
        let mut start = [0; 4];
        file.read_exact(&mut start).map_err(unreadable)?;
        let order = byte_order(&start).ok_or_else(|| {
            bad(path, "is not a TIFF file", "it does not start like one, despite its name", "write the file again")
        })?;
        Ok(Self { path, file, length, endian: order.0, is_big: order.1 })
    }

    fn damaged(&self, what: &str) -> Error {
        bad(
            self.path,
            format!("is a damaged TIFF file: {what}"),
            "its pixels cannot be found",
            "copy or download the file again",
        )
    }

    /// Reads `count` bytes at a position. Fails before it allocates memory that the file cannot
    /// fill.
    fn read(&mut self, at: u64, count: u64) -> Result<Vec<u8>> {
        if at.checked_add(count).is_none_or(|end| end > self.length) {
            return Err(self.damaged("a directory or its values lie beyond the end of the file"));
        }
        let mut bytes = vec![0; count as usize];
        let read = self.file.seek(SeekFrom::Start(at)).and_then(|_| self.file.read_exact(&mut bytes));
        read.map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => self.damaged("it ends within a directory"),
            _ => Error::file(self.path, "read", error, "copy or download the file again"),
        })?;
        Ok(bytes)
    }

    /// Returns an unsigned integer of up to eight bytes.
    fn number(&self, bytes: &[u8]) -> u64 {
        let join = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        match self.endian {
            Endian::Little => bytes.iter().rev().fold(0, join),
            Endian::Big => bytes.iter().fold(0, join),
        }
    }

    /// Returns the position of the first directory.
    fn first(&mut self) -> Result<u64> {
        let (at, size) = if self.is_big { (8, 8) } else { (4, 4) };
        let bytes = self.read(at, size)?;
        Ok(self.number(&bytes))
    }

    /// Reads a directory. Also returns the position of the next one, or 0.
    fn entries(&mut self, at: u64) -> Result<(Vec<Entry>, u64)> {
        // sizes of the number of entries, of an entry, and of a position or count
        let (head, entry, size) = if self.is_big { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.read(at, head)?;
        let count = self.number(&count);
        if count > MOST_TAGS {
            return Err(self.damaged("a directory has too many tags"));
        }
        let bytes = self.read(at + head, count * entry + size)?;
        let (entries, next) = bytes.split_at((count * entry) as usize);
        let entries = entries.chunks_exact(entry as usize).map(|entry| Entry {
            tag: self.number(&entry[..2]) as u16,
            kind: self.number(&entry[2..4]) as u16,
            count: self.number(&entry[4..4 + size as usize]),
            value: entry[4 + size as usize..].to_vec(),
        });
        Ok((entries.collect(), self.number(next)))
    }

    /// Returns the bytes of the values of a tag and the size of a value, or `None` if the tag is
    /// missing.
    fn values(&mut self, entries: &[Entry], tag: u16) -> Result<Option<(Vec<u8>, usize, u16)>> {
        let Some(entry) = entries.iter().find(|entry| entry.tag == tag) else { return Ok(None) };
        let size = match entry.kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16..=18 => 8,
            _ => return Err(self.damaged(&format!("tag {tag} has the unknown type {}", entry.kind))),
        };
        let Some(length) = entry.count.checked_mul(size) else {
            return Err(self.damaged(&format!("tag {tag} has too many values")));
        };
        let bytes = match entry.value.get(..length as usize) {
            Some(bytes) if length <= entry.value.len() as u64 => bytes.to_vec(),
            _ => self.read(self.number(&entry.value), length)?,
        };
        Ok(Some((bytes, size as usize, entry.kind)))
    }

    /// Returns the unsigned integers of a tag.
    fn integers(&mut self, entries: &[Entry], tag: u16) -> Result<Option<Vec<u64>>> {
        match self.values(entries, tag)? {
            None => Ok(None),
            Some((bytes, size, 1 | 3 | 4 | 13 | 16 | 18)) => {
                Ok(Some(bytes.chunks_exact(size).map(|bytes| self.number(bytes)).collect()))
            }
            Some(_) => Err(self.damaged(&format!("tag {tag} is not an integer"))),
        }
    }

    /// Returns the first integer of a tag, or `default`.
    fn integer(&mut self, entries: &[Entry], tag: u16, default: u64) -> Result<u64> {
        Ok(self.integers(entries, tag)?.and_then(|values| values.first().copied()).unwrap_or(default))
    }

    fn text(&mut self, entries: &[Entry], tag: u16) -> Result<String> {
        let bytes = self.values(entries, tag)?.map_or_else(Vec::new, |(bytes, _, _)| bytes);
        Ok(String::from_utf8_lossy(bytes.split(|&byte| byte == 0).next().unwrap_or_default()).into_owned())
    }

    fn resolution(&mut self, entries: &[Entry]) -> Result<Option<([f64; 2], u64)>> {
        let mut pixels = [0.0; 2];
        for (pixels, tag) in pixels.iter_mut().zip([282, 283]) {
            if let Some((bytes, 8, 5)) = self.values(entries, tag)?
                && let Some((above, below)) = bytes.get(..8).map(|bytes| bytes.split_at(4))
            {
                *pixels = self.number(above) as f64 / self.number(below) as f64;
            }
        }
        let unit = self.integer(entries, 296, 2)?;
        Ok(pixels.iter().all(|&pixels| pixels > 0.0 && pixels.is_finite()).then_some((pixels, unit)))
    }

    /// Reads the tags that describe the pixels, with the defaults of TIFF 6.0.
    fn tags(&mut self, entries: &[Entry]) -> Result<Tags> {
        Ok(Tags {
            width: self.integer(entries, 256, 0)?,
            height: self.integer(entries, 257, 0)?,
            bits: self.integers(entries, 258)?.unwrap_or_else(|| vec![1]),
            compression: self.integer(entries, 259, 1)?,
            photometric: self.integer(entries, 262, 1)?,
            fill_order: self.integer(entries, 266, 1)?,
            samples: self.integer(entries, 277, 1)?,
            predictor: self.integer(entries, 317, 1)?,
            sample_format: self.integer(entries, 339, 1)?,
            depth: self.integer(entries, 32997, 1)?,
            is_reduced: self.integer(entries, 254, 0)? & 1 == 1,
        })
    }

    /// Reads the description of the pixels of a page.
    fn page(&mut self, entries: &[Entry], tags: &Tags, number: usize) -> Result<Page> {
        let (path, length) = (self.path, self.length);
        let refused = |(what, why): (String, &str)| {
            bad(
                path,
                format!("page {number} {what}"),
                why,
                "write it as gray values of 8, 16 or 32 bits without or with LZW or deflate compression, for example \
                 with ImageJ",
            )
        };
        let (scalar, compression, predictor) = tags.pixels().map_err(refused)?;
        let [width, height] = [tags.width, tags.height].map(|n| n as usize);
        let is_tiled = entries.iter().any(|entry| entry.tag == 324);
        let chunk = match is_tiled {
            true => [self.integer(entries, 322, 0)? as usize, self.integer(entries, 323, 0)? as usize],
            false => [width, self.integer(entries, 278, u64::MAX)?.min(tags.height) as usize],
        };
        if chunk.contains(&0) {
            return Err(self.damaged("its strips or tiles are empty"));
        }
        let mut page = Page {
            size: [width, height],
            scalar,
            bits: tags.bits[0] as usize,
            endian: self.endian,
            compression,
            predictor,
            chunk,
            is_tiled,
            chunks: Vec::new(),
        };
        let (offsets, counts) = if is_tiled { (324, 325) } else { (273, 279) };
        let offsets = self.integers(entries, offsets)?.unwrap_or_default();
        let counts = self.integers(entries, counts)?.unwrap_or_default();
        page.place(&offsets, &counts, length).map_err(|what| self.damaged(&format!("page {number}: {what}")))?;
        Ok(page)
    }
}
