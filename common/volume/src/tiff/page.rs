//! Describes the pixels of a TIFF page: number type, compression, predictor, strips and tiles.

use crate::voxels::{Endian, ScalarType};

/// How strips and tiles are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lzw,
    Deflate,
    PackBits,
}

/// How the values of a row are encoded before compression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Predictor {
    /// As the values themselves.
    None,
    /// As differences between neighbouring values.
    Horizontal,
    /// As differences between neighbouring bytes. All first bytes of the values precede all second
    /// bytes, and so on.
    FloatingPoint,
}

/// The tags of a page that describe its pixels, with the numbers of TIFF 6.0.
pub(super) struct Tags {
    pub(super) width: u64,
    pub(super) height: u64,
    pub(super) bits: Vec<u64>,
    pub(super) compression: u64,
    pub(super) photometric: u64,
    pub(super) fill_order: u64,
    pub(super) samples: u64,
    pub(super) predictor: u64,
    pub(super) sample_format: u64,
    /// Number of slices in a tile.
    pub(super) depth: u64,
    /// Whether the page is a reduced version of another one.
    pub(super) is_reduced: bool,
}

/// A strip or tile in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk {
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

/// A page with one number per pixel.
#[derive(Clone, Debug)]
pub(super) struct Page {
    /// Width and height in pixels.
    pub(super) size: [usize; 2],
    /// Type of the values. Values of fewer than 8 bits become bytes.
    pub(super) scalar: ScalarType,
    /// Number of bits of a value in the file.
    pub(super) bits: usize,
    pub(super) endian: Endian,
    pub(super) compression: Compression,
    pub(super) predictor: Predictor,
    /// Width and height of a strip or tile.
    pub(super) chunk: [usize; 2],
    pub(super) is_tiled: bool,
    /// The strips or tiles, row by row.
    pub(super) chunks: Vec<Chunk>,
}

impl Tags {
    /// Returns the type, compression and predictor of the pixels. An error consists of the problem
    /// and its reason.
    pub(super) fn pixels(&self) -> Result<(ScalarType, Compression, Predictor), (String, &'static str)> {
        let one = "a volume must have one number per voxel";
        if self.samples != 1 || self.bits.len() != 1 {
            return Err((format!("has {} values per pixel, such as colours", self.samples), one));
        }
        // 0 and 1 are gray values, 3 indices of a palette and 4 a mask
        if !matches!(self.photometric, 0 | 1 | 3 | 4) {
            return Err((format!("contains colours (PhotometricInterpretation {})", self.photometric), one));
        }
        if self.depth != 1 || self.fill_order != 1 {
            return Err(("has tiles of several slices or reversed bits".to_owned(), "this is not supported"));
        }
        let scalar = match (self.bits[0], self.sample_format) {
            (1 | 2 | 4 | 8, 1 | 4) => ScalarType::U8,
            (16, 1 | 4) => ScalarType::U16,
            (32, 1 | 4) => ScalarType::U32,
            (64, 1 | 4) => ScalarType::U64,
            (8, 2) => ScalarType::I8,
            (16, 2) => ScalarType::I16,
            (32, 2) => ScalarType::I32,
            (64, 2) => ScalarType::I64,
            (32, 3) => ScalarType::F32,
            (64, 3) => ScalarType::F64,
            (bits, format) => {
                let name = match format {
                    3 => "floating-point numbers",
                    5 | 6 => "complex numbers",
                    _ => "integers",
                };
                return Err((format!("contains {name} of {bits} bits"), "this type of number is not supported"));
            }
        };
        let compression = Compression::numbered(self.compression)?;
        // as in libtiff, the predictor is ignored for other compressions
        let is_predicted = matches!(compression, Compression::Lzw | Compression::Deflate);
        let predictor = match (self.predictor, self.bits[0], scalar) {
            (1, ..) => Predictor::None,
            _ if !is_predicted => Predictor::None,
            (2, 8.., _) => Predictor::Horizontal,
            (3, _, ScalarType::F32 | ScalarType::F64) => Predictor::FloatingPoint,
            (other, bits, _) => {
                return Err((format!("has predictor {other} for {bits} bits"), "this combination is not defined"));
            }
        };
        Ok((scalar, compression, predictor))
    }
}

impl Compression {
    /// Returns the compression for its code in TIFF 6.0 or a later extension.
    fn numbered(number: u64) -> Result<Self, (String, &'static str)> {
        let name = match number {
            1 => return Ok(Self::None),
            5 => return Ok(Self::Lzw),
            8 | 32946 => return Ok(Self::Deflate),
            32773 => return Ok(Self::PackBits),
            2..=4 => "fax",
            6 | 7 => "JPEG",
            34712 => "JPEG 2000",
            34925 => "LZMA",
            50000 => "zstd",
            50001 => "WebP",
            _ => "an unknown method",
        };
        Err((format!("is compressed with {name} ({number})"), "this compression is not supported"))
    }

    /// Returns the maximum number of bytes that `stored` bytes can decompress to. A deflate symbol
    /// of 2 bits gives at most 258 bytes, an LZW code of 12 bits at most 4096, and two bytes of
    /// PackBits at most 128.
    fn most_bytes(self, stored: u64) -> u64 {
        stored.saturating_mul(match self {
            Self::None => 1,
            Self::Lzw => 4096 * 8 / 12 + 1,
            Self::Deflate => 258 * 8 / 2,
            Self::PackBits => 64,
        })
    }
}

impl Page {
    /// Returns the number of bytes in a row of a strip or tile.
    pub(super) fn row_bytes(&self) -> usize {
        self.chunk[0].saturating_mul(self.bits).div_ceil(8)
    }

    /// Returns the number of rows in a strip or tile. Only the last strip may be shorter.
    pub(super) fn rows(&self, chunk: usize) -> usize {
        if self.is_tiled { self.chunk[1] } else { self.chunk[1].min(self.size[1] - chunk * self.chunk[1]) }
    }

    /// Returns the number of strips or tiles along each axis.
    pub(super) fn grid(&self) -> [usize; 2] {
        [0, 1].map(|axis| self.size[axis].div_ceil(self.chunk[axis]))
    }

    /// Sets the strips or tiles to those at `offsets` with lengths `counts`.
    ///
    /// # Errors
    /// If they are not in a file of `length` bytes, or cannot contain the pixels.
    pub(super) fn place(&mut self, offsets: &[u64], counts: &[u64], length: u64) -> Result<(), String> {
        let [across, down] = self.grid();
        let count = across.saturating_mul(down);
        let is_plain = self.compression == Compression::None;
        if count == 0 || offsets.len() < count || !is_plain && counts.len() < count {
            return Err(format!("{} strips or tiles instead of {count}", offsets.len()));
        }
        for chunk in 0..count {
            let needed = (self.rows(chunk) as u64).saturating_mul(self.row_bytes() as u64);
            // some programs write wrong lengths for uncompressed strips
            let bytes = if is_plain { needed } else { counts[chunk] };
            if offsets[chunk].checked_add(bytes).is_none_or(|end| end > length) {
                return Err(format!("strip or tile {chunk} lies beyond the end of the file, which is truncated"));
            }
            if needed > self.compression.most_bytes(bytes) {
                return Err(format!("strip or tile {chunk} of {bytes} bytes cannot contain {needed} bytes of pixels"));
            }
            self.chunks.push(Chunk { offset: offsets[chunk], bytes });
        }
        Ok(())
    }
}
