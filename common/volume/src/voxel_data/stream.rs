//! Decodes the bytes of a data file.

use super::Coding;
use bzip2::bufread::BzDecoder;
use flate2::bufread::{GzDecoder, ZlibDecoder};
use std::io::{self, BufRead, ErrorKind, Read};

/// A reader that decodes data. gzip and bzip2 data may consist of several members. Like the gzip
/// and bzip2 programs, the reader stops at bytes that do not start another member.
pub(crate) enum Stream<R> {
    Plain(R),
    Hex(HexReader<R>),
    Zlib(ZlibDecoder<R>),
    Gzip(GzDecoder<R>),
    Bzip2(BzDecoder<R>),
    /// After the last member.
    End(Option<R>),
}

impl<R: BufRead> Stream<R> {
    /// Starts decoding at the current position of the reader. Text is passed through unchanged.
    pub(crate) fn new(reader: R, coding: Coding) -> Self {
        match coding {
            Coding::Raw | Coding::Text => Self::Plain(reader),
            Coding::Hex => Self::Hex(HexReader { inner: reader }),
            Coding::Zlib => Self::Zlib(ZlibDecoder::new(reader)),
            Coding::Gzip => Self::Gzip(GzDecoder::new(reader)),
            Coding::Bzip2 => Self::Bzip2(BzDecoder::new(reader)),
        }
    }

    /// Returns whether more data follows. If not, the decoder has verified the checksum.
    pub(crate) fn has_more(&mut self) -> io::Result<bool> {
        Ok(self.read(&mut [0])? > 0)
    }

    /// Returns whether any bytes follow the compressed data.
    pub(crate) fn leaves_bytes(self) -> io::Result<bool> {
        let rest = match self {
            Self::Plain(_) | Self::Hex(_) => None,
            Self::Zlib(decoder) => Some(decoder.into_inner()),
            Self::Gzip(decoder) => Some(decoder.into_inner()),
            Self::Bzip2(decoder) => Some(decoder.into_inner()),
            Self::End(reader) => reader,
        };
        rest.map_or(Ok(false), |mut rest| Ok(!rest.fill_buf()?.is_empty()))
    }
}

impl<R: BufRead> Read for Stream<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            let got = match self {
                Self::Plain(reader) => return reader.read(bytes),
                Self::Hex(reader) => return reader.read(bytes),
                Self::Zlib(decoder) => return decoder.read(bytes),
                Self::Gzip(decoder) => decoder.read(bytes)?,
                Self::Bzip2(decoder) => decoder.read(bytes)?,
                Self::End(_) => return Ok(0),
            };
            if got > 0 || bytes.is_empty() {
                return Ok(got);
            }
            let (mut rest, coding, first) = match std::mem::replace(self, Self::End(None)) {
                Self::Gzip(decoder) => (decoder.into_inner(), Coding::Gzip, 0x1f),
                Self::Bzip2(decoder) => (decoder.into_inner(), Coding::Bzip2, b'B'),
                other => {
                    *self = other;
                    return Ok(0);
                }
            };
            *self = match rest.fill_buf()?.first() {
                Some(byte) if *byte == first => Self::new(rest, coding),
                _ => Self::End(Some(rest)),
            };
        }
    }
}

/// Converts pairs of hexadecimal digits to bytes.
pub(crate) struct HexReader<R> {
    inner: R,
}

impl<R: BufRead> HexReader<R> {
    /// Returns the next digit, ignoring white space, or `None` at the end of the data.
    fn digit(&mut self) -> io::Result<Option<u8>> {
        loop {
            let Some(&byte) = self.inner.fill_buf()?.first() else { return Ok(None) };
            self.inner.consume(1);
            if byte.is_ascii_whitespace() {
                continue;
            }
            let value = char::from(byte).to_digit(16);
            let value = value.ok_or_else(|| io::Error::new(ErrorKind::InvalidData, "not a hexadecimal digit"))?;
            return Ok(Some(value as u8));
        }
    }
}

impl<R: BufRead> Read for HexReader<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        for (position, byte) in bytes.iter_mut().enumerate() {
            let Some(high) = self.digit()? else { return Ok(position) };
            let low = self.digit()?;
            let low = low.ok_or_else(|| io::Error::new(ErrorKind::UnexpectedEof, "it ends within a byte"))?;
            *byte = 16 * high + low;
        }
        Ok(bytes.len())
    }
}
