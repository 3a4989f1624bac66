//! Decodes the strips and tiles of a TIFF page.

use super::page::{Chunk, Compression, Page, Predictor};
use crate::voxels::Endian;
use flate2::bufread::ZlibDecoder;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use weezl::{BitOrder, LzwStatus, decode::Configuration};

/// Decodes a page of a file. `pixels` is filled row by row, in the byte order of the page.
pub(super) fn decode(file: &mut File, page: &Page, pixels: &mut [u8]) -> io::Result<()> {
    let [width, height] = page.size;
    let [across, _] = page.grid();
    let (row_bytes, pixel_bytes) = (page.row_bytes(), page.scalar.bytes());
    let is_direct = !page.is_tiled && page.bits >= 8;
    let (mut stored, mut decoded) = (Vec::new(), Vec::new());
    for (number, &chunk) in page.chunks.iter().enumerate() {
        let (x, y) = (number % across * page.chunk[0], number / across * page.chunk[1]);
        let rows = page.rows(number);
        let bytes = if is_direct {
            &mut pixels[y * row_bytes..][..rows * row_bytes]
        } else {
            decoded.resize(rows * row_bytes, 0);
            &mut decoded[..]
        };
        expand(file, chunk, page.compression, &mut stored, bytes)?;
        bytes.chunks_exact_mut(row_bytes).for_each(|row| predicted(row, page));
        if is_direct {
            continue;
        }
        // tiles extend beyond the page
        let columns = page.chunk[0].min(width - x);
        for (n, row) in decoded.chunks_exact(row_bytes).take(height - y).enumerate() {
            let to = &mut pixels[((y + n) * width + x) * pixel_bytes..][..columns * pixel_bytes];
            if page.bits >= 8 { to.copy_from_slice(&row[..to.len()]) } else { unpack(row, page.bits, to) }
        }
    }
    Ok(())
}

/// Reads and decompresses a strip or tile. Fails if it does not fill `bytes`. `stored` is a buffer.
fn expand(
    file: &mut File,
    chunk: Chunk,
    compression: Compression,
    stored: &mut Vec<u8>,
    bytes: &mut [u8],
) -> io::Result<()> {
    file.seek(SeekFrom::Start(chunk.offset))?;
    if compression == Compression::None {
        return file.read_exact(bytes);
    }
    stored.clear();
    file.take(chunk.bytes).read_to_end(stored)?;
    match compression {
        Compression::Deflate => ZlibDecoder::new(&stored[..]).read_exact(bytes),
        Compression::Lzw => lzw(stored, bytes),
        Compression::None | Compression::PackBits => pack_bits(stored, bytes),
    }
}

fn ends_early() -> io::Error {
    io::Error::new(ErrorKind::UnexpectedEof, "a strip or tile ends early")
}

fn lzw(mut stored: &[u8], mut bytes: &mut [u8]) -> io::Result<()> {
    // some programs write no end code, so decoding stops when the pixels are complete
    let configuration = Configuration::with_tiff_size_switch(BitOrder::Msb, 8).with_yield_on_full_buffer(true);
    let mut decoder = configuration.build();
    while !bytes.is_empty() {
        let result = decoder.decode_bytes(stored, bytes);
        stored = &stored[result.consumed_in..];
        bytes = &mut bytes[result.consumed_out..];
        match result.status {
            Ok(LzwStatus::Ok) if result.consumed_in + result.consumed_out > 0 => {}
            Ok(_) => break,
            Err(error) => return Err(io::Error::new(ErrorKind::InvalidData, error.to_string())),
        }
    }
    if bytes.is_empty() { Ok(()) } else { Err(ends_early()) }
}

fn pack_bits(mut stored: &[u8], mut bytes: &mut [u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        let (&code, rest) = stored.split_first().ok_or_else(ends_early)?;
        // code + 1 literal bytes follow a code below 128; one above 128 repeats the next byte
        let (count, used) = match code {
            0..128 => (usize::from(code) + 1, usize::from(code) + 1),
            128 => (0, 0),
            129.. => (257 - usize::from(code), 1),
        };
        let (source, rest) = rest.split_at_checked(used).ok_or_else(ends_early)?;
        let (to, behind) = bytes.split_at_mut(count.min(bytes.len()));
        match code {
            0..128 => to.copy_from_slice(&source[..to.len()]),
            _ => to.fill(source.first().copied().unwrap_or_default()),
        }
        (stored, bytes) = (rest, behind);
    }
    Ok(())
}

/// Converts values of fewer than 8 bits to bytes.
fn unpack(row: &[u8], bits: usize, to: &mut [u8]) {
    for (n, to) in to.iter_mut().enumerate() {
        let first = n * bits;
        *to = row[first / 8] << (first % 8) >> (8 - bits);
    }
}

/// Reverses the predictor: replaces the differences in a row by the values.
fn predicted(row: &mut [u8], page: &Page) {
    /// Adds the previous value to each value of `N` bytes.
    fn sum<const N: usize>(row: &mut [u8], add: impl Fn([u8; N], [u8; N]) -> [u8; N]) {
        let mut last = [0; N];
        for value in row.as_chunks_mut().0 {
            *value = add(*value, last);
            last = *value;
        }
    }
    macro_rules! sum {
        ($type:ty) => {
            match page.endian {
                Endian::Little => {
                    sum(row, |a, b| <$type>::from_le_bytes(a).wrapping_add(<$type>::from_le_bytes(b)).to_le_bytes())
                }
                Endian::Big => {
                    sum(row, |a, b| <$type>::from_be_bytes(a).wrapping_add(<$type>::from_be_bytes(b)).to_be_bytes())
                }
            }
        };
    }
    match (page.predictor, page.bits) {
        (Predictor::None, _) => {}
        (Predictor::Horizontal, 16) => sum!(u16),
        (Predictor::Horizontal, 32) => sum!(u32),
        (Predictor::Horizontal, 64) => sum!(u64),
        (Predictor::Horizontal, _) => sum!(u8),
        (Predictor::FloatingPoint, bits) => {
            sum(row, |[a], [b]| [a.wrapping_add(b)]);
            let (size, bytes) = (bits / 8, row.to_vec());
            let count = row.len() / size;
            for (place, &byte) in bytes.iter().enumerate() {
                // the most significant bytes come first
                let (number, value) = (place / count, place % count);
                let at = if page.endian == Endian::Big { number } else { size - 1 - number };
                row[value * size + at] = byte;
            }
        }
    }
}
