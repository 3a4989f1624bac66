//! Decodes the bytes of one array. A header with the length precedes the data. The data is raw or
//! encoded in base64, and uncompressed or compressed in zlib blocks.

use crate::voxels::Endian;
use std::io::{self, BufRead, Read};

/// The layout of the arrays in a file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) endian: Endian,
    /// True if the numbers in array headers have 64 bits, false if they have 32 bits.
    pub(super) wide_header: bool,
    pub(super) compressed: bool,
}

/// A reader that decodes the bytes of one array.
pub(super) struct ArrayReader<'a> {
    source: Box<dyn Read + 'a>,
    blocks: Option<Blocks>,
    /// Length of the decoded array in bytes, according to its header.
    pub(super) length: u64,
}

/// The remaining blocks of a compressed array.
struct Blocks {
    compressed: std::vec::IntoIter<u64>,
    block_bytes: u64,
    current: io::Cursor<Vec<u8>>,
}

impl<'a> ArrayReader<'a> {
    /// Starts decoding at the header of an array.
    pub(super) fn new(source: Box<dyn BufRead + 'a>, base64: bool, layout: Layout) -> io::Result<Self> {
        let mut source: Box<dyn Read + 'a> =
            if base64 { Box::new(Base64Reader { inner: source, held: [0; 3], from: 3 }) } else { source };
        let first = header_number(&mut source, layout)?;
        if !layout.compressed {
            return Ok(Self { source, blocks: None, length: first });
        }
        let block_bytes = header_number(&mut source, layout)?;
        let last_bytes = header_number(&mut source, layout)?;
        let mut compressed = Vec::new();
        for _ in 0..first {
            compressed.push(header_number(&mut source, layout)?);
        }
        let full = if last_bytes > 0 { first.saturating_sub(1) } else { first };
        let length = full.checked_mul(block_bytes).and_then(|bytes| bytes.checked_add(last_bytes));
        let length = length.ok_or_else(|| io::Error::other("its header is damaged"))?;
        let blocks = Blocks { compressed: compressed.into_iter(), block_bytes, current: io::Cursor::default() };
        Ok(Self { source, blocks: Some(blocks), length })
    }
}

impl Read for ArrayReader<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let Some(blocks) = &mut self.blocks else { return self.source.read(bytes) };
        loop {
            let got = blocks.current.read(bytes)?;
            if got > 0 || bytes.is_empty() {
                return Ok(got);
            }
            let Some(compressed_bytes) = blocks.compressed.next() else { return Ok(0) };
            let mut compressed = Read::take(&mut self.source, compressed_bytes);
            let mut decoder = flate2::read::ZlibDecoder::new(&mut compressed);
            let mut block = Vec::new();
            // the limit bounds the memory use if a damaged block is longer than its header declares
            Read::take(&mut decoder, blocks.block_bytes).read_to_end(&mut block)?;
            io::copy(&mut compressed, &mut io::sink())?;
            blocks.current = io::Cursor::new(block);
        }
    }
}

/// Reads one number from an array header.
fn header_number(source: &mut dyn Read, layout: Layout) -> io::Result<u64> {
    let mut wide = [0; 8];
    let mut narrow = [0; 4];
    if layout.wide_header {
        source.read_exact(&mut wide)?;
    } else {
        source.read_exact(&mut narrow)?;
    }
    Ok(match (layout.wide_header, layout.endian) {
        (true, Endian::Little) => u64::from_le_bytes(wide),
        (true, Endian::Big) => u64::from_be_bytes(wide),
        (false, Endian::Little) => u32::from_le_bytes(narrow).into(),
        (false, Endian::Big) => u32::from_be_bytes(narrow).into(),
    })
}

/// Decodes base64 in groups of four digits. Decoding continues after padding, because VTK encodes
/// the header of a compressed array separately from its data.
struct Base64Reader<R> {
    inner: R,
    held: [u8; 3],
    from: usize,
}

impl<R: BufRead> Base64Reader<R> {
    /// Decodes the next group into `held`. Returns false at the end of the base64 data.
    fn next_group(&mut self) -> io::Result<bool> {
        let mut bits = 0u32;
        let mut digits = 0;
        let mut padding = 0;
        while digits + padding < 4 {
            let Some(&byte) = self.inner.fill_buf()?.first() else { break };
            let value = match byte {
                b'A'..=b'Z' => Some(byte - b'A'),
                b'a'..=b'z' => Some(byte - b'a' + 26),
                b'0'..=b'9' => Some(byte - b'0' + 52),
                b'+' => Some(62),
                b'/' => Some(63),
                _ => None,
            };
            match value {
                Some(value) if padding == 0 => {
                    bits = bits << 6 | u32::from(value);
                    digits += 1;
                }
                None if byte == b'=' => padding += 1,
                None if byte.is_ascii_whitespace() => {}
                _ => break,
            }
            self.inner.consume(1);
        }
        if digits == 0 && padding == 0 {
            return Ok(false);
        }
        if digits + padding < 4 || digits < 2 {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "its base64 text is damaged"));
        }
        let [_, a, b, c] = (bits << (6 * padding)).to_be_bytes();
        // the decoded bytes are at the end of `held`, starting at index `from`
        (self.held, self.from) = match padding {
            0 => ([a, b, c], 0),
            1 => ([0, a, b], 1),
            _ => ([0, 0, a], 2),
        };
        Ok(true)
    }
}

impl<R: BufRead> Read for Base64Reader<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        for (position, byte) in bytes.iter_mut().enumerate() {
            if self.from == 3 && !self.next_group()? {
                return Ok(position);
            }
            *byte = self.held[self.from];
            self.from += 1;
        }
        Ok(bytes.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(text: &str) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        Base64Reader { inner: text.as_bytes(), held: [0; 3], from: 3 }.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    #[test]
    fn base64_goes_on_behind_padding() {
        assert_eq!(decode("aGVs\n bG8=d29ybGQ=").expect("two groups"), b"helloworld");
        assert_eq!(decode("YQ==YmM=").expect("two groups"), b"abc");
        assert_eq!(decode("YWJj</DataArray>").expect("ends at the tag"), b"abc");
        assert!(decode("YWJ").is_err());
        assert!(decode("=AAA").is_err());
    }

    #[test]
    fn a_compressed_array_with_a_damaged_header_is_no_panic() {
        let layout = Layout { endian: Endian::Little, wide_header: true, compressed: true };
        let mut bytes = Vec::new();
        for number in [u64::MAX, u64::MAX, 7, 3] {
            bytes.extend(number.to_le_bytes());
        }
        assert!(ArrayReader::new(Box::new(&bytes[..]), false, layout).is_err());
    }
}
