//! Voxel values in ten scalar types, and their conversion from and to bytes.

mod coded;

use crate::error::{Error, Result};
use crate::image::{reverse_slices, reversed_axes};
use coded::Coded;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// Scalar type of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScalarType {
    /// Signed 8-bit integer.
    I8,
    /// Unsigned 8-bit integer.
    U8,
    /// Signed 16-bit integer.
    I16,
    /// Unsigned 16-bit integer.
    U16,
    /// Signed 32-bit integer.
    I32,
    /// Unsigned 32-bit integer.
    U32,
    /// Signed 64-bit integer.
    I64,
    /// Unsigned 64-bit integer.
    U64,
    /// 32-bit floating-point number.
    F32,
    /// 64-bit floating-point number.
    F64,
}

/// Byte order of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endian {
    /// Least significant byte first.
    Little,
    /// Most significant byte first.
    Big,
}

/// Values of one of the ten scalar types.
#[derive(Clone, Debug, PartialEq)]
pub enum Voxels {
    /// Signed 8-bit integers.
    I8(Vec<i8>),
    /// Unsigned 8-bit integers.
    U8(Vec<u8>),
    /// Signed 16-bit integers.
    I16(Vec<i16>),
    /// Unsigned 16-bit integers.
    U16(Vec<u16>),
    /// Signed 32-bit integers.
    I32(Vec<i32>),
    /// Unsigned 32-bit integers.
    U32(Vec<u32>),
    /// Signed 64-bit integers.
    I64(Vec<i64>),
    /// Unsigned 64-bit integers.
    U64(Vec<u64>),
    /// 32-bit floating-point numbers.
    F32(Vec<f32>),
    /// 64-bit floating-point numbers.
    F64(Vec<f64>),
}

/// Number of bytes that a thread reads each time it opens the file. Opening, seeking and closing
/// take 6 us, which is 4 % of the 150 us that reading a chunk from the page cache takes (both timed
/// in loops on 2 busy cores, 2026-11-27).
const CHUNK_BYTES: usize = 1 << 20;

/// Evaluates an expression with the vector inside any variant of [`Voxels`].
macro_rules! each_type {
    ($voxels:expr, $values:ident => $body:expr) => {
        match $voxels {
            Voxels::I8($values) => $body,
            Voxels::U8($values) => $body,
            Voxels::I16($values) => $body,
            Voxels::U16($values) => $body,
            Voxels::I32($values) => $body,
            Voxels::U32($values) => $body,
            Voxels::I64($values) => $body,
            Voxels::U64($values) => $body,
            Voxels::F32($values) => $body,
            Voxels::F64($values) => $body,
        }
    };
}

/// Evaluates an expression with the Rust type and the `Voxels` variant of a scalar type.
macro_rules! with_type {
    ($scalar:expr, $type:ident, $variant:ident => $body:expr) => {
        with_type!(@arms $scalar, $type, $variant, $body;
            I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64)
    };
    (@arms $scalar:expr, $type:ident, $variant:ident, $body:expr; $($name:ident $rust:ty),*) => {
        match $scalar {
            $(ScalarType::$name => {
                type $type = $rust;
                let $variant = Voxels::$name;
                $body
            })*
        }
    };
}

// must follow the macros that it uses
mod pool;

pub(crate) use pool::Blocks;
pub use pool::Pooling;

impl ScalarType {
    /// Returns the size of a value in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Returns the name of the type in NRRD and NumPy, such as `int16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "int8",
            Self::U8 => "uint8",
            Self::I16 => "int16",
            Self::U16 => "uint16",
            Self::I32 => "int32",
            Self::U32 => "uint32",
            Self::I64 => "int64",
            Self::U64 => "uint64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }
}

/// Creates the error for a file that ends after `found` of `count` values.
fn ends_early(found: usize, count: usize) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::UnexpectedEof, format!("it ends after {found} of {count} values"))
}

/// A Rust number type that [`Voxels`] can contain.
trait Number: Copy {
    /// Converts the value to a label. Integers that fit into `i64` are unchanged, except for
    /// floating-point values above 2^53. NaN becomes 0. Returns `None` for any other value.
    fn to_label(self) -> Option<i64>;
    fn single(self) -> f32;
    fn double(self) -> f64;
    fn rounded(value: f64) -> Self;
}

macro_rules! integer_number {
    ($($type:ty),*) => {$(impl Number for $type {
        fn to_label(self) -> Option<i64> {
            i64::try_from(self).ok()
        }
        fn single(self) -> f32 {
            self as f32
        }
        fn double(self) -> f64 {
            self as f64
        }
        fn rounded(value: f64) -> Self {
            value as Self
        }
    })*};
}
integer_number!(i8, u8, i16, u16, i32, u32, i64, u64);

/// Converts a value to an integer. Returns `None` unless the value is an integer with a magnitude
/// of at most 2^53, because `f64` cannot represent all larger integers.
fn whole_number(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() <= 9_007_199_254_740_992.0).then_some(value as i64)
}

impl Number for f32 {
    fn to_label(self) -> Option<i64> {
        f64::from(self).to_label()
    }
    fn single(self) -> f32 {
        self
    }
    fn double(self) -> f64 {
        self.into()
    }
    fn rounded(value: f64) -> Self {
        value as Self
    }
}

impl Number for f64 {
    fn to_label(self) -> Option<i64> {
        // SPM and AFNI mark voxels outside a mask with NaN
        if self.is_nan() { Some(0) } else { whole_number(self) }
    }
    fn single(self) -> f32 {
        self as f32
    }
    fn double(self) -> f64 {
        self
    }
    fn rounded(value: f64) -> Self {
        value
    }
}

impl Voxels {
    /// Returns the scalar type of the values.
    pub fn scalar_type(&self) -> ScalarType {
        match self {
            Self::I8(_) => ScalarType::I8,
            Self::U8(_) => ScalarType::U8,
            Self::I16(_) => ScalarType::I16,
            Self::U16(_) => ScalarType::U16,
            Self::I32(_) => ScalarType::I32,
            Self::U32(_) => ScalarType::U32,
            Self::I64(_) => ScalarType::I64,
            Self::U64(_) => ScalarType::U64,
            Self::F32(_) => ScalarType::F32,
            Self::F64(_) => ScalarType::F64,
        }
    }

    /// Returns the name of the scalar type, such as `int16`.
    pub fn type_name(&self) -> &'static str {
        self.scalar_type().name()
    }

    /// Returns the number of values.
    pub fn len(&self) -> usize {
        each_type!(self, values => values.len())
    }

    /// Returns whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Converts the values to 32-bit floating-point numbers. Integers with magnitudes above 2^24
    /// are rounded.
    pub fn to_f32(&self) -> Vec<f32> {
        each_type!(self, values => values.iter().map(|&value| value.single()).collect())
    }

    /// Fills `to` with the values starting at index `first`, converted to 32-bit floating-point
    /// numbers. Integers with magnitudes above 2^24 are rounded.
    pub fn copy_as_f32(&self, first: usize, to: &mut [f32]) {
        let range = first..first + to.len();
        each_type!(self, values => to.iter_mut().zip(&values[range]).for_each(|(to, &value)| *to = value.single()));
    }

    /// Converts the values to 64-bit floating-point numbers. Integers with magnitudes above 2^53
    /// are rounded.
    pub fn to_f64(&self) -> Vec<f64> {
        each_type!(self, values => values.iter().map(|&value| value.double()).collect())
    }

    /// Returns the minimum and maximum of the finite values, or `None` if no value is finite.
    pub fn range(&self) -> Option<(f64, f64)> {
        let (low, high) = each_type!(self, values => values
            .iter()
            .map(|&value| value.double())
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value))));
        (low <= high).then_some((low, high))
    }

    /// Returns the number of NaN values. If the values are labels, NaN counts as background.
    pub fn nan_count(&self) -> usize {
        match self {
            Self::F32(values) => values.par_iter().filter(|value| value.is_nan()).count(),
            Self::F64(values) => values.par_iter().filter(|value| value.is_nan()).count(),
            _ => 0,
        }
    }

    /// Returns the distinct values in ascending order. NaN counts as 0.
    ///
    /// # Errors
    /// If a value is neither an integer nor NaN.
    pub fn label_set(&self) -> Result<Vec<i64>> {
        each_type!(self, values => distinct(values)).map_err(|value| Error::NotALabel { value })
    }

    /// Marks the values that equal any of the labels.
    pub fn label_mask(&self, labels: &[i64]) -> Vec<bool> {
        each_type!(self, values => values
            .par_iter()
            .map(|&value| Number::to_label(value).is_some_and(|label| labels.contains(&label)))
            .collect())
    }

    /// Calls `visit` with the label and the length of each run of equal values in `range`. The
    /// label of NaN is 0. Values that are not labels give `None`.
    pub fn each_run(&self, range: Range<usize>, mut visit: impl FnMut(Option<i64>, usize)) {
        each_type!(self, all => all[range].chunk_by(|a, b| a == b).for_each(|run| visit(run[0].to_label(), run.len())));
    }

    /// Reverses the order of slices of `length` values; see [`reverse_slices`].
    pub fn reverse_slices(&mut self, length: usize) {
        each_type!(self, values => reverse_slices(values, length));
    }

    /// Returns the positions of the first and last value in `range` whose label satisfies `wanted`,
    /// relative to the start of the range. Returns `None` if there is no such value.
    pub fn ends_of_labels(&self, range: Range<usize>, wanted: impl Fn(i64) -> bool) -> Option<(usize, usize)> {
        each_type!(self, values => {
            // equal labels usually form long runs
            let runs = || values[range.clone()].chunk_by(|a, b| a == b);
            let is_other = |run: &&[_]| !Number::to_label(run[0]).is_some_and(&wanted);
            let before: usize = runs().take_while(is_other).map(<[_]>::len).sum();
            let behind: usize = runs().rev().take_while(is_other).map(<[_]>::len).sum();
            (before < range.len()).then(|| (before, range.len() - 1 - behind))
        })
    }

    /// Returns the positions of the first and last value in `range` that satisfies `wanted` after
    /// conversion to a 32-bit floating-point number. The positions are relative to the start of the
    /// range. Returns `None` if there is no such value.
    pub fn ends_of_values(&self, range: Range<usize>, wanted: impl Fn(f32) -> bool) -> Option<(usize, usize)> {
        each_type!(self, values => {
            let values = &values[range];
            let first = values.iter().position(|value| wanted(value.single()))?;
            Some((first, values.iter().rposition(|value| wanted(value.single()))?))
        })
    }

    /// Crops a grid of `size` voxels (x fastest) in place to the box of `to` voxels whose first
    /// voxel is `first`. Releases the unused memory.
    pub fn crop(&mut self, size: [usize; 3], first: [usize; 3], to: [usize; 3]) {
        each_type!(self, values => {
            for row in 0..to[1] * to[2] {
                let (j, k) = (first[1] + row % to[1], first[2] + row / to[1]);
                let from = (k * size[1] + j) * size[0] + first[0];
                values.copy_within(from..from + to[0], row * to[0]);
            }
        });
        self.truncate(to.iter().product());
    }

    /// Reverses the order of the three axes; see [`reversed_axes`].
    pub(crate) fn reversed_axes(self, size: [usize; 3]) -> Self {
        macro_rules! arms {
            ($($variant:ident),*) => {
                match self {
                    $(Self::$variant(values) => Self::$variant(reversed_axes(&values, size)),)*
                }
            };
        }
        arms!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64)
    }

    /// Keeps the first `count` values and releases the unused memory.
    pub fn truncate(&mut self, count: usize) {
        each_type!(self, values => {
            values.truncate(count);
            values.shrink_to_fit();
        });
    }

    /// Reads `count` values. Allocates memory only as data arrives, because a damaged header may
    /// declare too many values.
    pub fn read_from(reader: &mut dyn Read, scalar: ScalarType, endian: Endian, count: usize) -> std::io::Result<Self> {
        with_type!(scalar, Value, variant => {
            let mut values: Vec<Value> = Vec::new();
            while values.len() < count {
                let first = values.len();
                values.resize(count.min(first + CHUNK_BYTES / size_of::<Value>()), Value::default());
                let chunk = &mut values[first..];
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(chunk);
                let got = fill(reader, bytes)?;
                if got < bytes.len() {
                    return Err(ends_early(first + got / size_of::<Value>(), count));
                }
                Value::arrange(chunk, endian);
            }
            Ok(variant(values))
        })
    }

    /// Reads `count` values from a file, starting at byte `start`, on all threads. Like
    /// [`Self::read_from`], does not allocate memory for missing data.
    pub fn read_file(
        path: &Path,
        start: u64,
        scalar: ScalarType,
        endian: Endian,
        count: usize,
    ) -> std::io::Result<Self> {
        let there = std::fs::metadata(path)?.len().saturating_sub(start) / scalar.bytes() as u64;
        if there < count as u64 {
            return Err(ends_early(there as usize, count));
        }
        Self::filled(scalar, count, CHUNK_BYTES / scalar.bytes(), |number, bytes| {
            let mut file = File::open(path)?;
            file.seek(SeekFrom::Start(start + (number * CHUNK_BYTES) as u64))?;
            file.read_exact(bytes)?;
            Ok(endian)
        })
    }

    /// Creates `count` values in parts of `part` values, on all threads. `fill` gets the number of
    /// a part and its bytes, which it writes in the byte order that it returns.
    pub(crate) fn filled<E: Send>(
        scalar: ScalarType,
        count: usize,
        part: usize,
        fill: impl Fn(usize, &mut [u8]) -> std::result::Result<Endian, E> + Sync,
    ) -> std::result::Result<Self, E> {
        with_type!(scalar, Value, variant => {
            let mut values = vec![Value::default(); count];
            values.par_chunks_mut(part).enumerate().try_for_each(|(number, values)| {
                let endian = fill(number, bytemuck::cast_slice_mut(values))?;
                Value::arrange(values, endian);
                Ok(())
            })?;
            Ok(variant(values))
        })
    }

    /// Creates an empty vector of a scalar type.
    pub fn empty(scalar: ScalarType) -> Self {
        with_type!(scalar, Value, variant => variant(Vec::<Value>::new()))
    }

    /// Appends the values of another vector of the same type. Does nothing if the types differ.
    pub fn append(&mut self, other: Self) {
        macro_rules! arms {
            ($($variant:ident),*) => {
                match (self, other) {
                    $((Self::$variant(values), Self::$variant(mut more)) => values.append(&mut more),)*
                    _ => {}
                }
            };
        }
        arms!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64);
    }

    /// Converts the numbers to the scalar type and appends them.
    pub fn extend_from_f64(&mut self, numbers: Vec<f64>) {
        each_type!(self, values => numbers.into_iter().for_each(|number| values.push(Number::rounded(number))));
    }

    /// Splits the values into `layers` layers, which are interleaved in runs of `run` values.
    pub fn part(self, run: usize, layers: usize) -> Vec<Self> {
        macro_rules! arms {
            ($($variant:ident),*) => {
                match self {
                    $(Self::$variant(values) => (0..layers)
                        .map(|layer| {
                            let runs = values.chunks(run).skip(layer).step_by(layers);
                            Self::$variant(runs.flatten().copied().collect())
                        })
                        .collect(),)*
                }
            };
        }
        arms!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64)
    }

    /// Parses a value and appends it. Returns false if the string is not a number of the scalar
    /// type. Integers may be written as `3.0`.
    pub fn push_text(&mut self, text: &str) -> bool {
        each_type!(self, values => {
            let parsed = text.parse().ok().or_else(|| whole_number(text.parse().ok()?)?.to_string().parse().ok());
            parsed.map(|value| values.push(value)).is_some()
        })
    }

    /// Writes the values as bytes in the given byte order.
    pub fn write_to(&self, writer: &mut dyn std::io::Write, endian: Endian) -> std::io::Result<()> {
        each_type!(self, values => {
            let mut buffer = Vec::with_capacity(1 << 16);
            for chunk in values.chunks(1 << 13) {
                buffer.clear();
                for value in chunk {
                    match endian {
                        Endian::Little => buffer.extend_from_slice(&value.to_le_bytes()),
                        Endian::Big => buffer.extend_from_slice(&value.to_be_bytes()),
                    }
                }
                writer.write_all(&buffer)?;
            }
        });
        Ok(())
    }
}

/// Reads until `bytes` is full or the data ends. Returns the number of bytes read.
fn fill(reader: &mut dyn Read, bytes: &mut [u8]) -> std::io::Result<usize> {
    let mut got = 0;
    while got < bytes.len() {
        match reader.read(&mut bytes[got..]) {
            Ok(0) => break,
            Ok(more) => got += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}

/// Returns the distinct labels. The error contains the first value that is not a label.
fn distinct<T: Number + PartialEq + std::fmt::Display + Sync>(values: &[T]) -> std::result::Result<Vec<i64>, String> {
    let of_part = |values: &[T]| {
        // equal labels usually form long runs
        let runs = values.chunk_by(|a, b| a == b).map(|run| run[0]);
        runs.map(|value| value.to_label().ok_or_else(|| value.to_string())).collect()
    };
    let parts: Vec<std::result::Result<BTreeSet<i64>, String>> = values.par_chunks(1 << 20).map(of_part).collect();
    let mut labels = BTreeSet::new();
    for part in parts {
        labels.extend(part?);
    }
    Ok(labels.into_iter().collect())
}

#[cfg(test)]
mod tests;
